"""What a search has found so far: which fit is kept, what is not done twice, and what chance is drawn beside."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from weighed_names import GATE, NOTHING, Evidence, beside, chance, fit, simulating, state_of

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.functions import CHANNELS
from bcid.diagnosis.search import search_state
from bcid.diagnosis.search.screen import NullGains
from bcid.diagnosis.search.search_state import SearchState
from bcid.errors import PredictionDiverged
from bcid.likelihood.score_test import TrialChanges

A = ("yaw_scrub",)


def test_of_fits_with_equal_effects_the_greatest_evidence_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Evidence(monkeypatch, {("a",): 5.0, ("b",): 30.0})
    state = state_of()
    fits = [fit(20.0, "a"), fit(0.0, "b"), fit(12.0, "a"), fit(21.0, "a")]
    found = [state.beside_remainder(f) for f in fits]
    assert [r.log_evidence for r in found] == [25.0, 30.0, 25.0, 26.0]
    assert state.weighed == {frozenset("a"): found[3], frozenset("b"): found[1]}
    assert state.likeliest == {frozenset("a"): fits[3], frozenset("b"): fits[1]}
    assert at.refitted == [("a",), ("b",), ("a",)]  # not where a likelier fit was there


def test_a_likelier_fit_is_kept_though_another_has_the_greater_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name must gain over the likeliest fit without it, and over the greatest evidence."""
    at = Evidence(monkeypatch, {("a",): 50.0})
    state, lesser, likelier = state_of(), fit(20.0, "a"), fit(60.0, "a")
    first = state.beside_remainder(lesser)
    at.adds[frozenset("a")] = 5.0
    found = state.beside_remainder(likelier)
    assert found.fit is first.fit
    assert found.log_evidence == state.weighed[frozenset("a")].log_evidence == 70.0
    assert found.named is state.likeliest[frozenset("a")] is likelier
    assert found.nats == pytest.approx(10.0)  # what the remainder adds to the likelier


def test_what_was_found_from_a_remainder_s_own_fit_does_not_spare_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Evidence(monkeypatch, {("a",): 50.0})
    state = state_of()
    state.remember(beside(fit(20.0, "a"), 10.0))
    assert state.beside_remainder(fit(20.0, "a")).log_evidence == 70.0
    assert at.refitted == [("a",)]


def test_what_is_seen_is_seen_beside_the_names_that_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """A remainder found from that of fewer names brings along what was seen beside those."""
    at = Evidence(monkeypatch, {(): 90.0, ("a",): 30.0})
    state = state_of()
    rest = state.beside_remainder(fit(0.0))
    at.from_rest[("a",)] = 95.0
    found = state.remember(at.add_beside_remainder(rest, fit(60.0, "a"), NOTHING))
    assert found.seen is rest.seen
    own = state.with_own_view(found)
    assert (own.seen.effects, own.seen.nats, own.log_evidence) == (("a",), 30.0, 95.0)
    assert state.weighed[frozenset("a")] is own
    assert state.with_own_view(own) is own
    # what comes of a likelier remainder that was kept is seen as the fit is, too
    assert state.beside_remainder(fit(60.0, "a")).seen is own.seen


def test_copies_beside_another_fit_with_the_same_names_are_found_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Evidence(monkeypatch, {})
    at.copies[("a",)] = 50.0
    state, first = state_of(), beside(fit(0.0, "a"), 10.0)
    for rest in first, first, beside(fit(0.0, "a"), 20.0):
        assert state.with_copies(rest, ("fx",)).nats == 50.0
    assert len(at.copied) == 2


def test_evidence_that_ended_early_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is less than that of the fit, so that a name beside it would seem to add more than it does."""
    at = Evidence(monkeypatch, {("a",): 50.0})
    at.unsettled.add(("a",))
    state = state_of()
    assert not state.beside_remainder(fit(20.0, "a")).settled
    assert state.weighed == {}
    at.unsettled.clear()
    whole = state.beside_remainder(fit(20.0, "a"))
    at.unsettled.add(("a",))
    at.adds[frozenset("a")] = 40.0
    assert state.beside_remainder(fit(25.0, "a"), to_exceed=90.0).fit is whole.fit  # which is the greater


@pytest.mark.parametrize(
    ("given", "adds", "evidence"), [(-40.0, 120.0, 80.0), (-40.0, 70.0, 50.0), (None, 120.0, 50.0)]
)
def test_a_remainder_may_be_found_from_the_simulation_as_it_is_given(
    given: float | None, adds: float, evidence: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The names keep their refit; the remainder is the likelier one, that of the refit where the simulation fails."""
    at, state = Evidence(monkeypatch, {(): 50.0}), state_of()
    rest = state.beside_remainder(fit(0.0))
    at.adds[frozenset()] = adds

    def evaluate(take: Any, hypothesis: Any, phi: Any, scales: Any) -> Any:
        if given is None:
            raise PredictionDiverged("")
        # a correction is where the refit has found it
        assert phi == ("a car", {"tyre_fall__f": 0.2, "steering_offset__o": 0.01})
        return fit(given)

    monkeypatch.setattr(search_state, "evaluate_fixed", evaluate)
    rest.named.phi, rest.named.hypothesis.phi_at = None, lambda car, values: (car, values)
    rest.named.hypothesis.effect_values = lambda phi: {"tyre_fall__f": 0.1, "steering_offset__o": 0.01}
    simulation: Any = SimpleNamespace(
        car=lambda: "a car", phi=None, scales=None,
        hypothesis=SimpleNamespace(effect_values=lambda phi: {"tyre_fall__f": 0.2}),
    )  # fmt: skip
    state.given = simulation
    found = state.beside_remainder_from_given(rest)
    assert found.log_evidence == evidence
    assert (found.named, found.seen) == (rest.named, rest.seen)
    assert (found.fit is rest.fit) == (evidence == 50.0)
    assert state.beside_remainder(rest.named).log_evidence == evidence  # from here on
    begun = len(at.refitted)
    assert state.beside_remainder_from_given(found) is found
    assert len(at.refitted) == begun  # once is enough


def test_a_remainder_from_the_simulation_that_is_less_likely_leaves_one_that_ended_early(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    at, state = Evidence(monkeypatch, {A: 10.0}), state_of()
    monkeypatch.setattr(search_state, "evaluate_fixed", lambda *_: fit(0.0, *A))
    rest = beside(fit(0.0, *A), 50.0)._replace(settled=False)
    rest.named.phi, rest.named.hypothesis.phi_at = None, lambda car, values: None
    rest.named.hypothesis.effect_values = lambda phi: {}
    simulation: Any = SimpleNamespace(
        car=lambda: None, phi=None, scales=None, hypothesis=SimpleNamespace(effect_values=lambda phi: {})
    )
    state.given = simulation
    assert state.beside_remainder_from_given(rest) is rest
    assert at.refitted == [A]


def test_trials_and_chance_are_those_beside_the_names_that_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated anew where these change, without what is excluded; the same fit has the same gate."""
    simulated, drawn = simulating(monkeypatch, "a", "b", "c", "d"), list[Any]()

    def draw(f: Any, take: Any, some: TrialChanges) -> NullGains:
        drawn.append((f, [t.effect for t in some.trials]))
        return chance(GATE + len(drawn))

    monkeypatch.setattr(search_state, "sample_null_gains", draw)
    state = SearchState(NOTHING, NOTHING, ("d",), refused={"c"})
    first, second = beside(fit(0.0)), beside(fit(0.0, "a"))
    gates = list[float]()
    for rest in (first, second, second, first):
        state.draw_nulls(rest)
        gates.append(state.gate)
    assert simulated == [(), ("a",)]
    assert drawn == [(first.fit, ["a", "b", "c"]), (second.fit, ["b", "c"])]
    assert gates == [GATE + 1.0, GATE + 2.0, GATE + 2.0, GATE + 1.0]


def test_an_effect_s_gate_is_its_own_level_or_its_placebo() -> None:
    """The level of others is none of its business; without one of its own it must exceed what any does."""
    drawn = chance(GATE)._replace(levels={"rear_toe": 2.0, "mass_change": 50.0, "motor_dead_zone": 9.0})
    assert [drawn.gate_of(name) for name in ("rear_toe", "mass_change", "motor_dead_zone", "yaw_scrub")] == [
        3.0, 50.0, 9.0, GATE,
    ]  # fmt: skip


def test_the_gate_of_a_name_that_is_held_is_the_last_beside_a_fit_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    simulating(monkeypatch, "a", "b")
    levels = iter([{"a": 10.0, "b": 20.0}, {"b": 21.0}])
    monkeypatch.setattr(search_state, "sample_null_gains", lambda *_: chance()._replace(levels=next(levels)))
    state = state_of()
    assert state.gate_of("a") == GATE  # nothing has been drawn
    state.draw_nulls(beside(fit(0.0)))
    state.draw_nulls(beside(fit(0.0, "a")))
    assert (state.gate_of("a"), state.gate_of("b"), state.gate_of("a", "b"), state.gate_of()) == (
        10.0, 21.0, 21.0, GATE,
    )  # fmt: skip
    assert state.required_nats(1e3 * GATE, "a") == pytest.approx(SEARCH_LIMITS.remainder_error * 1e3 * GATE)
    assert state.required_nats(0.0, "a") == 10.0


@pytest.mark.parametrize(("adds", "held"), [(60.0, True), (40.0, False)])
def test_a_remainder_may_hold_copies_where_they_make_the_take_likelier(
    adds: float, held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are tried once."""
    at, state = Evidence(monkeypatch, {}), state_of()
    rest = beside(fit(100.0, *A), 50.0)
    assert state.with_copies(rest, ("fy",)) is rest
    assert at.copied == []
    at.copies[A] = adds
    looking = state_of()
    for _ in range(2):
        full = looking.with_copies(rest, CHANNELS)
    assert at.copied == [(A, CHANNELS)]
    assert full.log_evidence == (160.0 if held else 150.0)

"""What names are worth: what counts beside a remainder and without it, and what goes."""

from __future__ import annotations

from typing import Any

import pytest
from weighed_names import GATE, NOTHING, Evidence, beside, chance, explained, fit, trials, weights_of

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.functions import CHANNELS
from bcid.diagnosis.search import name_weights
from bcid.diagnosis.search.name_weights import NameWeights
from bcid.diagnosis.search.refits import named_effects
from bcid.diagnosis.search.screen import NullGains
from bcid.likelihood.score_test import TrialChanges


def test_of_fits_with_equal_effects_the_greatest_evidence_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Evidence(monkeypatch, {("a",): 5.0, ("b",): 30.0})
    looking = weights_of()
    found = [looking.beside_remainder(f) for f in (fit(20.0, "a"), fit(0.0, "b"), fit(12.0, "a"), fit(21.0, "a"))]
    assert [r.log_evidence for r in found] == [25.0, 30.0, 25.0, 26.0]
    assert looking.tried == {frozenset("a"): found[3], frozenset("b"): found[1]}
    assert at.refitted == [("a",), ("b",), ("a",)]  # not where a likelier fit was there


def test_evidence_that_ended_early_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is less than that of the fit, so that a name beside it would seem to add more than it does."""
    Evidence(monkeypatch, {})
    looking = weights_of()
    looking.remember(beside(fit(20.0, "a"))._replace(settled=False))
    assert looking.tried == {}


def test_trials_and_chance_are_those_beside_the_names_that_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated anew where these change, once, without what is excluded; no trial of what was refused."""
    simulated, drawn = list[tuple[str, ...]](), list[Any]()

    def simulate(f: Any, take: Any) -> TrialChanges:
        simulated.append(f.hypothesis.effects)
        return trials("a", "b", "c", "d")

    def draw(f: Any, take: Any, some: TrialChanges) -> NullGains:
        drawn.append((f, [t.effect for t in some.trials]))
        return chance(GATE + len(drawn))

    monkeypatch.setattr(name_weights, "simulate_trials", simulate)
    monkeypatch.setattr(name_weights, "sample_null_gains", draw)
    looking = NameWeights(NOTHING, NOTHING, trials("a", "b", "c"), ("d",), (), chance(), {}, {"c": 1.0})
    first, second = beside(fit(0.0)), beside(fit(0.0, "a"))
    for rest in (first, second, second):
        looking.draw_nulls(rest)
    assert simulated == [("a",)]
    assert drawn == [(first.fit, ["a", "b"]), (second.fit, ["b"]), (second.fit, ["b"])]
    assert looking.gate == GATE + 3.0


# --- which names stay ------------------------------------------------------------------------------------------------


def keeping(
    monkeypatch: pytest.MonkeyPatch, nats: dict[tuple[str, ...], float], adds: dict[tuple[str, ...], float]
) -> tuple[NameWeights, Evidence]:
    """A search beside refits of so much likelihood by their effects, and remainders that add so much to it."""
    likelihood = {frozenset(effects): value for effects, value in nats.items()}
    monkeypatch.setattr(
        name_weights, "refit_with_effects", lambda f, take, effects: fit(likelihood[frozenset(effects)], *effects)
    )
    return weights_of(), Evidence(monkeypatch, adds)


A, B, AB = ("yaw_scrub",), ("rear_toe",), ("yaw_scrub", "rear_toe")


@pytest.mark.parametrize(
    ("without", "remainder", "gains", "stays"),
    [
        (0.0, 0.0, 100.0, True),
        (0.0, 92.0, 8.0, False),  # a remainder explains as much without it
        (0.0, 80.0, 20.0, True),
        (95.0, 0.0, 5.0, False),  # it adds next to nothing itself, whatever remainders say
        (95.0, -60.0, 5.0, False),
    ],
)
def test_a_name_must_gain_beside_a_remainder_and_without_one(
    without: float, remainder: float, gains: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    looking, _ = keeping(monkeypatch, {A: 100.0, (): without}, {(): remainder})
    rest, kept, less = looking.keep_names(beside(fit(100.0, *A)))
    assert named_effects(rest.named) == (A if stays else ())
    if stays:
        assert kept == {"yaw_scrub": pytest.approx(gains)}
        assert less["yaw_scrub"].hypothesis.effects == ()
    else:
        assert (kept, less) == ({}, {})
        assert looking.refused["yaw_scrub"] == pytest.approx(gains)


def test_the_weakest_goes_first_and_the_rest_is_weighed_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both add little beside each other; the stronger adds much once the weaker is gone."""
    nats = {AB: 100.0, A: 95.0, B: 92.0, (): 0.0}
    looking, at = keeping(monkeypatch, nats, {})
    rest, kept, _ = looking.keep_names(beside(fit(100.0, *AB)))
    assert named_effects(rest.named) == A
    assert kept == {"yaw_scrub": 95.0}
    assert looking.refused == {"rear_toe": 5.0}
    assert sorted(at.refitted) == sorted([B, A, ()])


def test_what_was_tried_is_not_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    looking, at = keeping(monkeypatch, {AB: 300.0, A: 150.0, B: 100.0, (): 0.0}, {})
    looking.beside_remainder(fit(150.0, *A))
    at.refitted.clear()
    rest, kept, _ = looking.keep_names(beside(fit(300.0, *AB)))
    assert at.refitted == [B]
    assert kept == {"rear_toe": 150.0, "yaw_scrub": 200.0}
    assert named_effects(rest.named) == AB


@pytest.mark.parametrize(("share", "stays"), [(1.1, True), (0.9, False)])
def test_beside_a_large_remainder_a_name_must_add_more_than_smooth_functions_cannot_follow(
    share: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = 5000.0
    gains = share * SEARCH_LIMITS.remainder_error * left
    assert gains > GATE
    looking, _ = keeping(monkeypatch, {A: gains, (): 0.0}, {A: left, (): left})
    rest, _, _ = looking.keep_names(beside(fit(gains, *A), left))
    assert named_effects(rest.named) == (A if stays else ())


# --- copies of laws that have names ----------------------------------------------------------------------------------

FULL = {"fx": 200.0, "mz": 5.0}
"""What the channels explain beside all names."""


def test_a_constant_law_is_named_where_its_channel_needs_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else no constant could be named, as its copy would explain as much."""
    looking, at = keeping(monkeypatch, {A: 100.0, (): 0.0}, {})
    at.copies[()] = 100.0
    rest, kept, _ = looking.keep_names(beside(fit(100.0, *A)))
    assert kept == {"yaw_scrub": 100.0}
    assert at.copied == []
    assert named_effects(rest.named) == A


@pytest.mark.parametrize(("without", "gain"), [(298.0, 2.0), (270.0, 30.0), (150.0, 100.0)])
def test_copies_take_the_place_of_a_name_where_the_channel_is_needed_anyway(
    without: float, gain: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name is weighed against the remainder with copies in such channels, or without where that is likelier."""
    looking, at = keeping(monkeypatch, {A: 100.0, (): 0.0}, {A: 200.0, (): 200.0})
    at.copies[()] = without
    rest = beside(fit(100.0, *A), 200.0, explained(200.0, FULL))
    assert looking._gain(rest, rest, beside(fit(0.0), 200.0)) == pytest.approx(gain)
    assert at.copied == [((), ("fx",))]
    kept = looking.keep_names(rest)[1]
    assert set(kept) == ({"yaw_scrub"} if gain > GATE else set())


@pytest.mark.parametrize(("share", "needed"), [(1.05, True), (0.95, False)])
def test_a_channel_is_needed_that_adds_a_share_of_what_the_name_does(
    share: float, needed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    looking, at = keeping(monkeypatch, {}, {})
    gain = 1000.0
    nats = share * SEARCH_LIMITS.needed_share * gain
    assert nats > GATE
    full = beside(fit(gain, *A), nats, explained(nats, {"fy": nats}))
    looking._gain(full, full, beside(fit(0.0), nats))
    assert at.copied == ([((), ("fy",))] if needed else [])


def test_what_adds_too_little_anyway_is_not_weighed_against_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    looking, at = keeping(monkeypatch, {}, {})
    full = beside(fit(GATE - 1.0, *A), 200.0, explained(200.0, FULL))
    assert looking._gain(full, full, beside(fit(0.0), 200.0)) == pytest.approx(GATE - 1.0)
    assert at.copied == []


@pytest.mark.parametrize(("adds", "held"), [(60.0, True), (40.0, False)])
def test_the_remainder_beside_all_names_may_hold_copies(
    adds: float, held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where they make the take likelier; they are tried only where first order sees any."""
    looking, at = keeping(monkeypatch, {}, {})
    rest = beside(fit(100.0, *A), 50.0)
    assert looking._with_copies(rest) is rest
    assert at.copied == []
    at.seen[A], at.copies[A] = explained(70.0, None, "fx"), adds
    full = looking._with_copies(rest)
    assert at.copied == [(A, CHANNELS)]
    assert full.log_evidence == (160.0 if held else 150.0)

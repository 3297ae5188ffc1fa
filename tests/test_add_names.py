"""Names added one after the other: without a remainder, and beside one; what is not tried in vain."""

from __future__ import annotations

from typing import Any

import pytest
from weighed_names import GATE, NOTHING, Evidence, beside, chance, fit, simulating, state_of

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit
from bcid.diagnosis.search import add_names, refits, search_state
from bcid.diagnosis.search.add_names import (
    _best_credible,
    _promising,
    add_name,
    add_names_beside_remainder,
    add_names_plainly,
    weigh_plain_names,
)
from bcid.diagnosis.search.screen import CandidateEffect, NullGains
from bcid.diagnosis.search.search_state import SearchState
from bcid.likelihood.score_test import TrialChanges


@pytest.mark.parametrize(("explains", "alone"), [(0.51, True), (0.49, False)])
def test_a_remainder_is_sought_from_nothing_beside_what_explains_most_of_it(
    explains: float, alone: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside what explains little it is much the same as without, and found from there."""
    at = Evidence(monkeypatch, {("a",): 900.0})
    at.from_rest[("a",)] = 1400.0
    rest = beside(fit(0.0), 1000.0)
    found = _best_credible(state_of(), [fit(1000.0 * explains, "a")], rest, {})
    assert found is not None
    assert at.tried_from_rest == ([] if alone else [("a",)])
    assert found.log_evidence == pytest.approx(1410.0 if alone else 1400.0)
    assert at.refitted == [("a",)]  # the best one in any case


@pytest.mark.parametrize(("plain", "sought"), [(0.04, False), (0.06, True)])
def test_what_would_count_alone_has_a_remainder_of_its_own_where_that_of_the_rest_has_its_place(
    plain: float, sought: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside more than a twentieth of what has no name an effect would count, were the remainder not in its place."""
    left = 1000.0
    at = Evidence(monkeypatch, {("a",): left})
    at.from_rest[("a",)] = left - 5.0
    found = _best_credible(state_of(), [fit(plain * left, "a")], beside(fit(0.0), left), {})
    assert at.tried_from_rest == [("a",)]
    assert (found is not None) is sought
    assert at.refitted == ([("a",)] if sought else [])


def test_that_remainder_is_sought_beside_the_simulation_as_it_is_given_too(monkeypatch: pytest.MonkeyPatch) -> None:
    at, asked = Evidence(monkeypatch, {("a",): 900.0}), list[Any]()
    at.from_rest[("a",)] = 900.0
    given: Any = fit(-5.0)

    def from_given(state: SearchState, rest: Any, to_exceed: float) -> Any:
        asked.append(state.given)
        return beside(rest.named, 1300.0)

    monkeypatch.setattr(SearchState, "beside_remainder_from_given", from_given)
    rest, candidate = beside(fit(0.0), 1000.0), fit(100.0, "a")
    found = _best_credible(state_of(given=given), [candidate], rest, {})
    assert asked[0] is given
    assert found is not None
    assert found.log_evidence == pytest.approx(1400.0)


@pytest.mark.parametrize(("from_rest", "evidence"), [(1200.0, 1200.0), (1050.0, 1100.0)])
def test_plain_names_have_the_greater_evidence_of_a_remainder_of_their_own_and_that_of_the_rest(
    from_rest: float, evidence: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = Evidence(monkeypatch, {("a",): 1000.0})
    at.from_rest[("a",)] = from_rest
    found = weigh_plain_names(state_of(), beside(fit(0.0), 1000.0), fit(100.0, "a"))
    assert found.log_evidence == evidence
    assert at.tried_from_rest == [("a",)]


@pytest.mark.parametrize(("reached", "again"), [(0.49, True), (0.51, False)])
def test_where_little_comes_of_a_promise_an_effect_is_tried_from_the_remainder_s_own_fit(
    reached: float, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which may hold others that have no name yet."""
    at, promised = Evidence(monkeypatch, {}), 1000.0
    at.from_rest[("a",)] = 900.0
    share = 2.0 * SEARCH_LIMITS.kept_promise * reached
    found = _best_credible(state_of(), [fit(share * promised, "a")], beside(fit(0.0)), {"a": promised})
    assert at.tried_from_rest == ([("a",)] if again else [])
    assert found is not None
    assert found.log_evidence == pytest.approx(900.0 if again else share * promised)
    # of what was not promised, nothing is expected
    at.tried_from_rest.clear()
    _best_credible(state_of(), [fit(share * promised, "a")], beside(fit(0.0)), {"b": promised})
    assert at.tried_from_rest == []


@pytest.mark.parametrize("left", [0.0, 900.0])
def test_beside_a_large_remainder_a_name_must_add_more_than_smooth_functions_cannot_follow(
    left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    looking, at, adds = state_of(), Evidence(monkeypatch, {("a",): left}), GATE + 1.0
    at.from_rest[("a",)] = adds
    found = _best_credible(looking, [fit(adds - left, "a")], beside(fit(-left), left), {})
    assert (found is None) is (adds < SEARCH_LIMITS.remainder_error * left)
    # beside less that has no name it may count, and is told until then
    assert looking.refused == set()
    assert looking.added == ({} if found else {"a": pytest.approx(adds)})


def test_the_best_is_weighed_in_earnest(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best candidate is refitted fully, without a remainder too; the others keep their quick fits."""
    at = Evidence(monkeypatch, {("best",): 0.0})
    at.from_rest |= {("best",): 1400.0, ("near",): 1300.0}
    full = fit(450.0, "best")
    monkeypatch.setattr(refits, "refit_fully", lambda f, take: full if f.hypothesis.effects == ("best",) else f)
    found = _best_credible(state_of(), [fit(300.0, "near"), fit(400.0, "best")], beside(fit(0.0), 1000.0), {})
    assert found is not None
    assert found.named is full
    assert found.log_evidence == 1400.0
    assert at.refitted == [("best",)]


def test_without_fits_there_is_none_of_greatest_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    Evidence(monkeypatch, {})
    assert _best_credible(state_of(), [], beside(fit(0.0)), {}) is None


# --- one name more ---------------------------------------------------------------------------------------------------


def test_what_began_elsewhere_and_falls_short_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another start may make more of it; what the score test promised beside the remainder is not tried again."""
    Evidence(monkeypatch, {("near",): 0.0, ("far",): 0.0})
    looking = state_of()
    _best_credible(looking, [fit(1.0, "near")], beside(fit(0.0)), {}, [fit(1.0, "far")])
    assert looking.refused == {"near"}
    assert set(looking.added) == {"near"}


def offering(monkeypatch: pytest.MonkeyPatch, *scores: tuple[str, float], **nats: float) -> list[str]:
    """Score tests that promise so much of effects, and refits of so much likelihood; those that were offered a test."""
    offered = list[str]()

    def score(rest: RemainderFit, take: Any, trials: TrialChanges) -> list[CandidateEffect]:
        names = [t.effect for t in trials.trials]
        offered[:] = names
        return [CandidateEffect(name, [1.0], s) for name, s in scores if name in names]

    def quick(f: Any, take: Any, c: CandidateEffect) -> Any:
        return fit(nats.get(c.effect, 0.0), *f.hypothesis.effects, c.effect)

    monkeypatch.setattr(add_names, "score_names", score)
    monkeypatch.setattr(add_names, "screen_effects", lambda f, take, some: [])
    simulating(monkeypatch)
    monkeypatch.setattr(refits, "refit_along_tangent", quick)
    monkeypatch.setattr(refits, "refit_fully", lambda f, take: f)
    monkeypatch.setattr(search_state, "refit_from_large_sizes", lambda *_: [])
    return offered


def quietly(text: str) -> None:
    """No report."""


@pytest.mark.parametrize(("nats", "taken"), [(100.0 + GATE + 1.0, True), (100.0 + GATE - 1.0, False)])
def test_a_name_must_add_more_than_the_gate_to_what_a_remainder_explains_already(
    nats: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The likelihood grows by over 100 nats; beside the remainder by just the gate."""
    at = Evidence(monkeypatch, {(): 100.0, ("yaw_scrub",): 0.0})
    offering(monkeypatch, ("yaw_scrub", 90.0), yaw_scrub=nats)
    looking = state_of()
    simulating(monkeypatch, "yaw_scrub")
    found = add_name(looking, beside(fit(0.0), 100.0), [], quietly)
    assert (found is not None) is taken
    assert looking.refused == (set() if taken else {"yaw_scrub"})
    assert looking.added == ({} if taken else {"yaw_scrub": pytest.approx(GATE - 1.0)})
    assert at.tried_from_rest == [("yaw_scrub",)]  # as it promised far more


def test_what_was_refused_or_is_held_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Evidence(monkeypatch, {})
    offered = offering(monkeypatch, ("rear_toe", 90.0), ("motor_sag", 80.0), rear_toe=5.0, motor_sag=2.0)
    looking = state_of()
    looking.refused = {"floor_slope"}
    simulating(monkeypatch, "yaw_scrub", "rear_toe", "motor_sag", "floor_slope")
    rest = beside(fit(0.0, "yaw_scrub"))
    assert add_name(looking, rest, [], quietly) is None
    assert offered == ["rear_toe", "motor_sag"]
    assert set(looking.refused) == {"floor_slope", "rear_toe", "motor_sag"}
    at.refitted.clear()
    assert add_name(looking, rest, [], quietly) is None
    assert offered == []
    assert at.refitted == []


def test_only_what_promises_much_is_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A share of the best and of the gate, and not too many."""
    names = ["a", "b", "c", "d", "e", "f"]
    Evidence(monkeypatch, {})
    best = 1000.0
    least = SEARCH_LIMITS.near_best_share * best
    scores = [best, least + 1.0, least - 1.0]
    offering(monkeypatch, *zip(names, scores, strict=False))
    looking = state_of()
    simulating(monkeypatch, *names)
    assert [c.effect for c in _promising(looking, beside(fit(0.0)))] == ["a", "b"]
    small = SEARCH_LIMITS.min_score_share * GATE
    offering(monkeypatch, ("a", small + 0.1), ("b", small - 0.1))
    assert [c.effect for c in _promising(looking, beside(fit(0.0)))] == ["a"]
    offering(monkeypatch, *((name, 50.0) for name in names))
    assert len(_promising(looking, beside(fit(0.0)))) == SEARCH_LIMITS.max_candidates


def test_what_explains_most_without_a_remainder_is_refitted_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """If it explains more than chance; nothing is expected of it beside the remainder."""
    Evidence(monkeypatch, {})
    offering(monkeypatch, ("a", 90.0), ("b", 80.0))
    looking = state_of()
    simulating(monkeypatch, "a", "b", "c", "d", "e")

    def plain(*scores: tuple[str, float]) -> list[CandidateEffect]:
        some = [CandidateEffect(n, [2.0], s) for n, s in scores]
        monkeypatch.setattr(add_names, "screen_effects", lambda f, take, trials: some)
        return _promising(looking, beside(fit(0.0)))

    assert [c.effect for c in plain(("c", GATE + 1.0), ("d", GATE - 1.0))] == ["a", "b", "c"]
    found = plain(("c", 70.0), ("d", 60.0), ("e", 50.0))
    assert [(c.effect, c.values, c.score) for c in found[2:]] == [("c", [2.0], 0.0), ("d", [2.0], 0.0)]
    assert SEARCH_LIMITS.plain_candidates == 2
    assert [c.effect for c in plain(("a", 70.0), ("d", 60.0), ("e", 50.0))] == ["a", "b", "d"]


def test_an_effect_of_a_size_that_no_car_has_is_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """However much likelier it makes the take; the next best is taken."""
    Evidence(monkeypatch, {})
    offering(monkeypatch, ("yaw_scrub", 900.0), ("rear_toe", 500.0), yaw_scrub=900.0, rear_toe=300.0)
    monkeypatch.setattr(
        refits, "effects_at_bounds", lambda f, take: [n for n in f.hypothesis.effects if n == "yaw_scrub"]
    )
    looking = state_of()
    simulating(monkeypatch, "yaw_scrub", "rear_toe")
    found = add_name(looking, beside(fit(0.0)), [], quietly)
    assert found is not None
    assert found.named.hypothesis.effects == ("rear_toe",)


@pytest.mark.parametrize(("remainder", "asked"), [(GATE + 1.0, True), (GATE - 1.0, False)])
def test_what_the_base_model_takes_up_is_tried_where_a_remainder_is_left(
    remainder: float, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From large sizes, without what is excluded; what was refused from a small one is tried."""
    Evidence(monkeypatch, {(): remainder})
    offering(monkeypatch)
    given = list[tuple[str, ...]]()

    def large(f: Any, take: Any, others: tuple[str, ...]) -> list[Any]:
        given.append(tuple(others))
        return [fit(200.0, "motor_lag")]

    monkeypatch.setattr(search_state, "refit_from_large_sizes", large)
    looking = SearchState(NOTHING, NOTHING, ("motor_delay",), chance(), refused={"tyre_relaxation"})
    found = add_name(looking, beside(fit(0.0), remainder), [], quietly)
    assert given == ([("motor_delay",)] if asked else [])
    assert (found is not None) is asked


def test_a_fit_beside_the_reference_is_a_name_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    Evidence(monkeypatch, {})
    offering(monkeypatch, ("rear_toe", 90.0), rear_toe=90.0)
    looking = state_of()
    simulating(monkeypatch, "rear_toe")
    found = add_name(looking, beside(fit(0.0)), [fit(150.0, "yaw_scrub")], quietly)
    assert found is not None
    assert found.named.hypothesis.effects == ("yaw_scrub",)


# --- without a remainder ---------------------------------------------------------------------------------------------


def screening(monkeypatch: pytest.MonkeyPatch, **nats: float) -> list[tuple[str, ...]]:
    """Score tests that promise 90 nats of every effect, and refits of so much likelihood; the rounds, by their names.

    `nats` are what each effect adds to the likelihood, whatever stands beside it.
    """
    rounds = list[tuple[str, ...]]()
    offering(monkeypatch)

    def screen(f: Any, take: Any, some: TrialChanges) -> list[CandidateEffect]:
        rounds.append(f.hypothesis.effects)
        return [CandidateEffect(t.effect, [1.0], 90.0) for t in some.trials]

    def quick(f: Any, take: Any, c: CandidateEffect) -> Any:
        return fit(f.penalised_log_likelihood + nats[c.effect], *f.hypothesis.effects, c.effect)

    monkeypatch.setattr(add_names, "screen_effects", screen)
    monkeypatch.setattr(refits, "refit_along_tangent", quick)
    monkeypatch.setattr(refits, "effects_at_bounds", lambda f, take: ())
    simulating(monkeypatch, *nats)
    return rounds


def test_names_are_added_while_each_makes_the_take_likelier_by_more_than_the_gate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The likeliest first, whatever a remainder would take of it."""
    at = Evidence(monkeypatch, {(): 2000.0})
    rounds = screening(monkeypatch, yaw_scrub=300.0, rear_toe=900.0, motor_sag=GATE - 1.0)
    looking = state_of()
    simulating(monkeypatch, "yaw_scrub", "rear_toe", "motor_sag")
    found = add_names_plainly(looking, fit(0.0), [], quietly)
    assert found.hypothesis.effects == ("rear_toe", "yaw_scrub")
    assert rounds == [(), ("rear_toe",), ("rear_toe", "yaw_scrub")]
    assert at.refitted == []
    assert looking.refused == set()  # beside a remainder it may count


@pytest.mark.parametrize(("share", "added"), [(1.05, True), (0.95, False)])
def test_no_name_is_added_that_adds_less_than_what_has_no_name_may_pass_for(
    share: float, added: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside much that is unknown each of several wrong names would add more than the gate."""
    left = 3000.0
    at, looking = Evidence(monkeypatch, {("yaw_scrub",): left}), state_of()
    nats = share * SEARCH_LIMITS.remainder_error * left
    assert nats > GATE
    screening(monkeypatch, yaw_scrub=nats)
    found = add_names_plainly(looking, fit(0.0), [], quietly)
    assert found.hypothesis.effects == (("yaw_scrub",) if added else ())
    assert at.refitted == []


def test_one_that_falls_short_of_its_own_gate_keeps_no_other_from_being_added(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though it gains more: chance makes more of it; and such candidates crowd none out."""
    Evidence(monkeypatch, {})
    loud = {"mass_change": 100.0, "motor_delay": 99.0, "pose_latency": 98.0, "steering_lag": 97.0}
    screening(monkeypatch, **loud, yaw_scrub=30.0)
    looking = state_of(_gates=dict.fromkeys(loud, 300.0) | {"yaw_scrub": 15.0})
    assert add_names_plainly(looking, fit(0.0), [], quietly).hypothesis.effects == ("yaw_scrub",)
    screening(monkeypatch, mass_change=100.0, yaw_scrub=30.0)
    looking = state_of(_gates={"mass_change": 110.0, "yaw_scrub": 15.0})
    assert add_names_plainly(looking, fit(0.0), [fit(99.0, "mass_change")], quietly).hypothesis.effects == (
        "yaw_scrub",
    )


def test_without_a_remainder_a_fit_beside_the_reference_may_be_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    Evidence(monkeypatch, {})
    screening(monkeypatch, yaw_scrub=300.0)
    looking = state_of()
    simulating(monkeypatch, "yaw_scrub")
    found = add_names_plainly(looking, fit(0.0), [fit(500.0, "motor_lag")], quietly)
    assert found.hypothesis.effects == ("motor_lag", "yaw_scrub")


def test_there_are_no_more_names_than_are_given(monkeypatch: pytest.MonkeyPatch) -> None:
    ids = ("yaw_scrub", "rear_toe", "motor_sag", "floor_slope", "quadratic_drag", "motor_lag", "pose_scale")
    Evidence(monkeypatch, {})
    rounds = screening(monkeypatch, **dict.fromkeys(ids, 100.0))
    looking = state_of()
    simulating(monkeypatch, *ids)
    found = add_names_plainly(looking, fit(0.0), [], quietly)
    assert len(found.hypothesis.effects) == len(rounds) == SEARCH_LIMITS.max_effects


def test_beside_a_remainder_chance_is_drawn_anew_in_each_round(monkeypatch: pytest.MonkeyPatch) -> None:
    Evidence(monkeypatch, {(): 100.0})
    offering(monkeypatch, ("yaw_scrub", 900.0), yaw_scrub=900.0)
    drawn = list[tuple[str, ...]]()

    def draw(f: Any, take: Any, some: TrialChanges) -> NullGains:
        drawn.append(f.hypothesis.effects)
        return chance()

    monkeypatch.setattr(search_state, "sample_null_gains", draw)
    simulating(monkeypatch, "yaw_scrub")
    looking = state_of()
    found = add_names_beside_remainder(looking, beside(fit(0.0), 100.0), [], quietly)
    assert found.named.hypothesis.effects == ("yaw_scrub",)
    assert drawn == [(), ("yaw_scrub",)]


def test_a_refit_beside_a_remainder_need_not_exceed_less_than_the_best_and_the_gate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    at = Evidence(monkeypatch, {("near",): 1000.0})
    _best_credible(state_of(), [fit(2000.0, "best"), fit(995.0, "near")], beside(fit(50.0)), {})
    assert at.to_exceed == {("best",): 50.0 + GATE, ("near",): 2000.0}


@pytest.mark.parametrize("beside_better", [True, False])
def test_what_ended_early_for_want_of_a_better_s_evidence_is_not_refused(
    beside_better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may add more than the gate where the better one is held; only what cannot exceed the gate goes for good."""
    at = Evidence(monkeypatch, {}, near=1440.0)
    at.unsettled.add(("near",))
    looking, fits = state_of(), [fit(90.0, "near"), *([fit(1500.0, "best")] if beside_better else [])]
    found = _best_credible(looking, fits, beside(fit(0.0), 100.0), {})
    assert (found.named.hypothesis.effects if found else None) == (("best",) if beside_better else None)
    assert at.to_exceed[("near",)] == (1500.0 if beside_better else 100.0 + GATE)
    assert looking.refused == (set() if beside_better else {"near"})

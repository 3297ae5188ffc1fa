"""The search for names: what counts beside a remainder and without it, what goes, and what is not tried in vain."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from concealed import concealing

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit
from bcid.diagnosis.search import name_search
from bcid.diagnosis.search.name_search import NameSearch, Naming, name_effects, refit_beside_reference
from bcid.diagnosis.search.refits import named_effects
from bcid.diagnosis.search.screen import CandidateEffect, NullGains
from bcid.effects.table import EFFECTS
from bcid.errors import PredictionDiverged
from bcid.likelihood.score_test import Trial, TrialChanges

NOTHING: Any = None
GATE = 12.0


def fit(nats: float, *effects: str) -> Any:
    hypothesis = SimpleNamespace(effects=effects, assumed=())
    return SimpleNamespace(hypothesis=hypothesis, penalised_log_likelihood=nats)


class Evidence:
    """What a remainder adds beside fits, by their effects: to first order, and after refits that count themselves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, adds: dict[tuple[str, ...], float], **sketch: float) -> None:
        self.adds = {frozenset(effects): nats for effects, nats in adds.items()}
        self.sketch = sketch  # where evidence to first order is another
        self.refitted = list[tuple[str, ...]]()
        monkeypatch.setattr(name_search, "explain", lambda f, take, basis: self.explain(f))
        monkeypatch.setattr(name_search, "fit_with_remainder", self.fit_with_remainder)

    def explain(self, f: Any) -> Any:
        nats = self.adds.get(frozenset(f.hypothesis.effects), 0.0)
        return SimpleNamespace(nats=self.sketch.get("+".join(f.hypothesis.effects), nats))

    def fit_with_remainder(self, f: Any, take: Any, basis: Any, seen: Any) -> RemainderFit:
        self.refitted.append(f.hypothesis.effects)
        adds = self.adds.get(frozenset(f.hypothesis.effects), 0.0)
        return RemainderFit(f, f, {}, f.penalised_log_likelihood + adds, NOTHING, NOTHING, seen)


def search(**more: Any) -> NameSearch:
    return NameSearch(NOTHING, NOTHING, TrialChanges(NOTHING, []), (), GATE, **more)


# --- beside a remainder ----------------------------------------------------------------------------------------------


def test_fits_are_ranked_by_their_evidence_beside_a_remainder(monkeypatch: pytest.MonkeyPatch) -> None:
    Evidence(monkeypatch, {("a",): 0.0, ("b",): 30.0})
    found = search().beside_remainder([fit(20.0, "a"), fit(0.0, "b")])
    assert [r.named.hypothesis.effects for r in found] == [("b",), ("a",)]
    assert [r.log_evidence for r in found] == [30.0, 20.0]


def test_what_lies_clearly_below_the_best_to_first_order_is_not_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """First order is known to a share of what the remainder explains, and some nats."""
    at = Evidence(monkeypatch, {("best",): 0.0, ("near",): 1000.0, ("far",): 1000.0})
    slack = SEARCH_LIMITS.remainder_error * 1000.0 + SEARCH_LIMITS.near_nats
    fits = [fit(2000.0 - 1000.0 - slack - 1.0, "far"), fit(2000.0, "best"), fit(2000.0 - 1000.0 - slack + 1.0, "near")]
    looking = search()
    found = looking.beside_remainder(fits)
    assert at.refitted == [("best",), ("near",)]
    assert [r.named.hypothesis.effects for r in found] == [("best",), ("near",)]
    assert set(looking.tried) == {frozenset({"best"}), frozenset({"near"})}


def test_a_single_fit_is_always_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Evidence(monkeypatch, {})
    assert search().beside_remainder([]) == []
    assert len(search().beside_remainder([fit(-1e6, "a")])) == 1
    assert at.refitted == [("a",)]


# --- one name more ---------------------------------------------------------------------------------------------------


def offering(monkeypatch: pytest.MonkeyPatch, *scores: tuple[str, float], **nats: float) -> list[str]:
    """Score tests that promise so much of effects, and refits of so much likelihood; those that were offered a test."""
    offered = list[str]()

    def score(f: Any, take: Any, seen: Any, trials: TrialChanges) -> list[CandidateEffect]:
        names = [t.effect for t in trials.trials]
        offered[:] = names
        return [CandidateEffect(name, [1.0], s) for name, s in scores if name in names]

    def quick(f: Any, take: Any, c: CandidateEffect) -> Any:
        return fit(nats.get(c.effect, 0.0), *f.hypothesis.effects, c.effect)

    monkeypatch.setattr(name_search, "score_names", score)
    monkeypatch.setattr(name_search.refits, "refit_along_tangent", quick)
    monkeypatch.setattr(name_search.refits, "refit_fully", lambda f, take: f)
    monkeypatch.setattr(name_search, "effects_at_bounds", lambda f, take: ())
    monkeypatch.setattr(name_search.refits, "refit_from_large_sizes", lambda *_: [])
    return offered


def trials(*names: str) -> TrialChanges:
    return TrialChanges(NOTHING, [Trial(name, [], slice(0)) for name in names])


def beside(named: Any, remainder: float = 0.0) -> RemainderFit:
    seen: Any = SimpleNamespace(nats=remainder)
    return RemainderFit(named, named, {}, named.penalised_log_likelihood + remainder, NOTHING, NOTHING, seen)


def quietly(text: str) -> None:
    """No report."""


@pytest.mark.parametrize(("nats", "taken"), [(100.0 + GATE + 1.0, True), (100.0 + GATE - 1.0, False)])
def test_a_name_must_add_more_than_the_gate_to_what_a_remainder_explains_already(
    nats: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The likelihood grows by over 100 nats; beside the remainder by just the gate."""
    Evidence(monkeypatch, {(): 100.0, ("yaw_scrub",): 0.0})
    offering(monkeypatch, ("yaw_scrub", 90.0), yaw_scrub=nats)
    looking = search()
    looking.trials = trials("yaw_scrub")
    found = looking.add_name(beside(fit(0.0), 100.0), [], quietly)
    assert (found is not None) is taken
    assert looking.refused == ({} if taken else {"yaw_scrub": pytest.approx(GATE - 1.0)})


def test_what_was_refused_or_is_held_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Evidence(monkeypatch, {})
    offered = offering(monkeypatch, ("rear_toe", 90.0), ("motor_sag", 80.0), rear_toe=5.0, motor_sag=2.0)
    looking = search()
    looking.trials, looking.refused = trials("yaw_scrub", "rear_toe", "motor_sag", "floor_slope"), {"floor_slope": 1.0}
    rest = beside(fit(0.0, "yaw_scrub"))
    assert looking.add_name(rest, [], quietly) is None
    assert offered == ["rear_toe", "motor_sag"]
    assert set(looking.refused) == {"floor_slope", "rear_toe", "motor_sag"}
    at.refitted.clear()
    assert looking.add_name(rest, [], quietly) is None
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
    looking = search()
    looking.trials = trials(*names)
    assert [c.effect for c in looking._promising(beside(fit(0.0)))] == ["a", "b"]
    small = SEARCH_LIMITS.min_score_share * GATE
    offering(monkeypatch, ("a", small + 0.1), ("b", small - 0.1))
    assert [c.effect for c in looking._promising(beside(fit(0.0)))] == ["a"]
    offering(monkeypatch, *((name, 50.0) for name in names))
    assert len(looking._promising(beside(fit(0.0)))) == SEARCH_LIMITS.max_candidates


def test_an_effect_of_a_size_that_no_car_has_is_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """However much likelier it makes the take; the next best is taken."""
    Evidence(monkeypatch, {})
    offering(monkeypatch, ("yaw_scrub", 900.0), ("rear_toe", 500.0), yaw_scrub=900.0, rear_toe=300.0)
    monkeypatch.setattr(
        name_search, "effects_at_bounds", lambda f, take: [n for n in f.hypothesis.effects if n == "yaw_scrub"]
    )
    looking = search()
    looking.trials = trials("yaw_scrub", "rear_toe")
    found = looking.add_name(beside(fit(0.0)), [], quietly)
    assert found is not None
    assert found.named.hypothesis.effects == ("rear_toe",)


@pytest.mark.parametrize(("remainder", "asked"), [(GATE + 1.0, True), (GATE - 1.0, False)])
def test_what_the_base_model_takes_up_is_tried_where_a_remainder_is_left(
    remainder: float, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From large sizes, without what is excluded or was refused."""
    Evidence(monkeypatch, {(): remainder})
    offering(monkeypatch)
    given = list[tuple[str, ...]]()

    def large(f: Any, take: Any, others: tuple[str, ...]) -> list[Any]:
        given.append(tuple(others))
        return [fit(200.0, "motor_lag")]

    monkeypatch.setattr(name_search.refits, "refit_from_large_sizes", large)
    looking = NameSearch(NOTHING, NOTHING, trials(), ("motor_delay",), GATE, {}, {"tyre_relaxation": 1.0})
    found = looking.add_name(beside(fit(0.0), remainder), [], quietly)
    assert given == ([("motor_delay", "tyre_relaxation")] if asked else [])
    assert (found is not None) is asked


def test_a_fit_beside_the_reference_is_a_name_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    Evidence(monkeypatch, {})
    offering(monkeypatch, ("rear_toe", 90.0), rear_toe=90.0)
    looking = search()
    looking.trials = trials("rear_toe")
    found = looking.add_name(beside(fit(0.0)), [fit(150.0, "yaw_scrub")], quietly)
    assert found is not None
    assert found.named.hypothesis.effects == ("yaw_scrub",)


# --- which names stay ------------------------------------------------------------------------------------------------


def keeping(
    monkeypatch: pytest.MonkeyPatch, nats: dict[tuple[str, ...], float], adds: dict[tuple[str, ...], float]
) -> tuple[NameSearch, Evidence]:
    """A search beside refits of so much likelihood by their effects, and remainders that add so much to it."""
    likelihood = {frozenset(effects): value for effects, value in nats.items()}
    monkeypatch.setattr(
        name_search, "refit_with_effects", lambda f, take, effects: fit(likelihood[frozenset(effects)], *effects)
    )
    return search(), Evidence(monkeypatch, adds)


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
    assert sorted(at.refitted) == sorted([B, A, A, ()])


def test_what_was_tried_is_not_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    looking, at = keeping(monkeypatch, {AB: 300.0, A: 150.0, B: 100.0, (): 0.0}, {})
    looking.beside_remainder([fit(150.0, *A)])
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


# --- from end to end -------------------------------------------------------------------------------------------------


def test_what_is_left_counts_beyond_chance_only() -> None:
    chance = NullGains(0.5, GATE, GATE, [CandidateEffect("rear_toe", [0.0], 3.0)])
    for nats, unknown in ((GATE - 1.0, 0.0), (GATE + 1.0, GATE + 1.0)):
        named = fit(0.0)
        found = Naming(named, named, beside(named), beside(named, nats), {}, {}, (), {}, chance)
        assert found.unknown_nats == unknown
    louder = chance._replace(placebos=[CandidateEffect("rear_toe", [0.0], GATE + 5.0)])
    assert found._replace(nulls=louder).unknown_nats == 0.0


def test_an_excluded_effect_is_never_named_nor_tried() -> None:
    base, take = concealing(yaw_scrub=20.0)
    texts = list[str]()
    found = name_effects(base, take, ("yaw_scrub", "yaw_coulomb"), report=texts.append)
    assert not {"yaw_scrub", "yaw_coulomb"} & {*found.gains, *found.dropped}
    assert not [r for r in found.rivals if {"yaw_scrub", "yaw_coulomb"} & set(r.hypothesis.effects)]
    assert not [text for text in texts if "yaw_scrub" in text or "yaw_coulomb" in text]
    assert found.before.nats > 500.0  # which is there


def test_two_effects_are_named_each_by_what_it_adds() -> None:
    base, take = concealing(yaw_scrub=20.0, rear_rolling_coulomb=20.0)
    found = name_effects(base, take)
    assert set(found.gains) == {"yaw_scrub", "rear_rolling_coulomb"} == set(named_effects(found.best))
    assert min(found.gains.values()) > found.nulls.gate
    assert found.unknown_nats == 0.0
    assert {n: named_effects(f) for n, f in found.without.items()} == {
        "yaw_scrub": ("rear_rolling_coulomb",), "rear_rolling_coulomb": ("yaw_scrub",),
    }  # fmt: skip
    assert found.before.log_evidence > found.corrected.penalised_log_likelihood + 500.0


def test_a_late_pose_is_named_instead_of_two_late_commands() -> None:
    from bcid.simulation.car import Sensor

    base, take = concealing(sensor=Sensor(pose_latency=0.015))
    found = name_effects(base, take)
    assert named_effects(found.best) == ("pose_latency",)
    value, se = found.best.effect_estimates()["pose_latency__tau"]
    assert abs(value - 0.015) < 4.0 * se
    assert EFFECTS["pose_latency"].kind == "measurement"


def test_beside_a_reference_the_first_effect_is_sought_from_its_own_parameters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = ["yaw_scrub", "rear_toe", "motor_sag", "floor_slope", "quadratic_drag"]
    given = list[tuple[str, ...]]()
    monkeypatch.setattr(name_search, "simulate_trials", lambda reference, take: trials(*names, "yaw_coulomb"))

    def screened(reference: Any, take: Any, some: TrialChanges) -> list[CandidateEffect]:
        given.append(tuple(t.effect for t in some.trials))
        return [CandidateEffect(name, [1.0], 50.0) for name in names]

    def quick(f: Any, take: Any, c: CandidateEffect) -> Any:
        if c.effect == "rear_toe":
            raise PredictionDiverged
        return fit(10.0, c.effect)

    monkeypatch.setattr(name_search, "screen_effects", screened)
    monkeypatch.setattr(name_search.refits, "refit_along_tangent", quick)
    monkeypatch.setattr(name_search.refits, "refit_fully", lambda f, take: f)
    found = refit_beside_reference(fit(0.0), NOTHING, ("yaw_coulomb",))
    assert given == [tuple(names)]
    tried = names[: SEARCH_LIMITS.max_candidates]
    assert [f.hypothesis.effects for f in found] == [(name,) for name in tried if name != "rear_toe"]

    def lost(*_: Any) -> Any:
        raise PredictionDiverged

    monkeypatch.setattr(name_search, "simulate_trials", lost)
    assert refit_beside_reference(fit(0.0), NOTHING, ()) == []

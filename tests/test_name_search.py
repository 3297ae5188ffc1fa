"""The search for names: what counts beside a remainder and without it, what goes, and what is not tried in vain."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from concealed import concealing

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.evidence import likeliest_spreads
from bcid.diagnosis.remainder.fit import RemainderFit
from bcid.diagnosis.remainder.functions import CHANNELS
from bcid.diagnosis.search import name_search
from bcid.diagnosis.search.name_search import (
    NameSearch,
    Naming,
    WeighedFit,
    name_effects,
    refit_beside_reference,
)
from bcid.diagnosis.search.refits import named_effects
from bcid.diagnosis.search.screen import CandidateEffect, NullGains
from bcid.effects.remainder import DIRECTION, DIRECTIONS
from bcid.effects.table import EFFECTS
from bcid.errors import PredictionDiverged
from bcid.likelihood.score_test import Trial, TrialChanges

NOTHING: Any = None
GATE = 12.0


def fit(nats: float, *effects: str) -> Any:
    hypothesis = SimpleNamespace(effects=effects, assumed=())
    return SimpleNamespace(hypothesis=hypothesis, penalised_log_likelihood=nats)


def explained(nats: float = 0.0, channels: dict[str, float] | None = None, *copied: str) -> Any:
    """What a remainder explains: nats in all, by channel, and the channels in which copies of laws are among it."""
    spread = {f"{channel}=": 1.0 for channel in copied}
    return SimpleNamespace(nats=nats, spread=spread, channel_nats=lambda: channels or {})


def beside(named: Any, remainder: float = 0.0, seen: Any = None) -> RemainderFit:
    nats = named.penalised_log_likelihood + remainder
    return RemainderFit(named, named, NOTHING, NOTHING, NOTHING, {}, nats, seen or explained(remainder))


class Evidence:
    """What a remainder adds beside fits, by their effects: to first order, and after refits that count themselves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, adds: dict[tuple[str, ...], float], **sketch: float) -> None:
        self.adds = {frozenset(effects): nats for effects, nats in adds.items()}
        self.sketch = sketch  # where evidence to first order is another
        self.seen = dict[tuple[str, ...], Any]()  # what is explained beside some effects, copies of laws among it
        self.copies = dict[tuple[str, ...], float]()  # what a remainder adds that holds such copies
        self.from_rest = dict[tuple[str, ...], float]()  # evidence that is found from a remainder's own fit
        self.refitted, self.tried_from_rest = list[tuple[str, ...]](), list[tuple[str, ...]]()
        self.copied = list[tuple[tuple[str, ...], tuple[str, ...]]]()
        monkeypatch.setattr(name_search, "explain", self.explain)
        monkeypatch.setattr(name_search, "fit_with_remainder", self.fit_with_remainder)
        monkeypatch.setattr(name_search, "add_beside_remainder", self.add_beside_remainder)

    def explain(self, f: Any, take: Any, basis: Any, copied: tuple[str, ...] = ()) -> Any:
        effects = f.hypothesis.effects
        if copied:
            return self.seen.get(effects, explained())
        return explained(self.sketch.get("+".join(effects), self.adds.get(frozenset(effects), 0.0)))

    def fit_with_remainder(
        self, f: Any, take: Any, basis: Any, copied: tuple[str, ...] = (), seen: Any = None
    ) -> RemainderFit:
        effects = f.hypothesis.effects
        if copied:
            self.copied.append((effects, copied))
            return beside(f, self.copies.get(effects, 0.0), seen)
        self.refitted.append(effects)
        return beside(f, self.adds.get(frozenset(effects), 0.0), seen)

    def add_beside_remainder(self, rest: RemainderFit, f: Any, seen: Any, take: Any) -> RemainderFit:
        effects = f.hypothesis.effects
        self.tried_from_rest.append(effects)
        nats = self.from_rest.get(effects, f.penalised_log_likelihood)
        return beside(f, nats - f.penalised_log_likelihood, seen)


def search(**more: Any) -> NameSearch:
    return NameSearch(NOTHING, NOTHING, TrialChanges(NOTHING, []), (), (), chance(), **more)


def chance(gate: float = GATE) -> NullGains:
    return NullGains(gate, [CandidateEffect("rear_toe", [0.0], 3.0)])


# --- beside a remainder ----------------------------------------------------------------------------------------------


def test_of_fits_with_equal_effects_the_greatest_evidence_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    Evidence(monkeypatch, {("a",): 5.0, ("b",): 30.0})
    looking = search()
    found = [looking.beside_remainder(f) for f in (fit(20.0, "a"), fit(0.0, "b"), fit(12.0, "a"), fit(21.0, "a"))]
    assert [r.log_evidence for r in found] == [25.0, 30.0, 17.0, 26.0]
    assert {key: w.log_evidence for key, w in looking.tried.items()} == {frozenset("a"): 26.0, frozenset("b"): 30.0}
    assert looking.tried[frozenset("a")].named is found[3].named


def test_what_lies_clearly_below_the_best_to_first_order_is_not_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """First order is known to a share of what the remainder explains, and some nats."""
    at = Evidence(monkeypatch, {("best",): 0.0, ("near",): 1000.0, ("far",): 1000.0})
    monkeypatch.setattr(name_search, "effects_at_bounds", lambda f, take: ())
    slack = SEARCH_LIMITS.remainder_error * 1000.0 + SEARCH_LIMITS.near_nats
    fits = [fit(2000.0 - 1000.0 - slack - 1.0, "far"), fit(2000.0, "best"), fit(2000.0 - 1000.0 - slack + 1.0, "near")]
    looking = search()
    found = looking._best_credible(fits, beside(fit(0.0)), {})
    assert found is not None
    assert found.named.hypothesis.effects == ("best",)
    assert at.refitted == [("best",), ("near",)]
    assert set(looking.tried) == {frozenset({"best"}), frozenset({"near"})}
    assert looking.refused == {}  # each is more than the gate


@pytest.mark.parametrize(("over", "refitted"), [(0.5, True), (-0.5, False)])
def test_what_cannot_exceed_the_gate_to_first_order_is_refused_without_a_refit(
    over: float, refitted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it adds is then at most what first order says; a refit knows better."""
    at = Evidence(monkeypatch, {})
    monkeypatch.setattr(name_search, "effects_at_bounds", lambda f, take: ())
    nats = 100.0 + GATE - SEARCH_LIMITS.near_nats + over
    looking = search()
    assert looking._best_credible([fit(nats, "a")], beside(fit(0.0), 100.0), {}) is None
    assert at.refitted == ([("a",)] if refitted else [])
    assert looking.refused == {"a": pytest.approx(nats - 100.0 if refitted else GATE + over)}


@pytest.mark.parametrize(("reached", "again"), [(0.49, True), (0.51, False)])
def test_where_little_comes_of_a_promise_an_effect_is_tried_from_the_remainder_s_own_fit(
    reached: float, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which may hold others that have no name yet."""
    at, promised = Evidence(monkeypatch, {}), 1000.0
    monkeypatch.setattr(name_search, "effects_at_bounds", lambda f, take: ())
    at.from_rest[("a",)] = 900.0
    share = 2.0 * SEARCH_LIMITS.kept_promise * reached
    found = search()._best_credible([fit(share * promised, "a")], beside(fit(0.0)), {"a": promised})
    assert at.tried_from_rest == ([("a",)] if again else [])
    assert found is not None
    assert found.log_evidence == pytest.approx(900.0 if again else share * promised)
    # of what was not promised, nothing is expected
    at.tried_from_rest.clear()
    search()._best_credible([fit(share * promised, "a")], beside(fit(0.0)), {"b": promised})
    assert at.tried_from_rest == []


def test_without_fits_there_is_none_of_greatest_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    Evidence(monkeypatch, {})
    assert search()._best_credible([], beside(fit(0.0)), {}) is None


# --- one name more ---------------------------------------------------------------------------------------------------


def offering(monkeypatch: pytest.MonkeyPatch, *scores: tuple[str, float], **nats: float) -> list[str]:
    """Score tests that promise so much of effects, and refits of so much likelihood; those that were offered a test."""
    offered = list[str]()

    def score(rest: RemainderFit, take: Any, trials: TrialChanges) -> list[CandidateEffect]:
        names = [t.effect for t in trials.trials]
        offered[:] = names
        return [CandidateEffect(name, [1.0], s) for name, s in scores if name in names]

    def quick(f: Any, take: Any, c: CandidateEffect) -> Any:
        return fit(nats.get(c.effect, 0.0), *f.hypothesis.effects, c.effect)

    monkeypatch.setattr(name_search, "score_names", score)
    monkeypatch.setattr(name_search, "screen_effects", lambda f, take, some: [])
    monkeypatch.setattr(name_search, "simulate_trials", NOTHING)
    monkeypatch.setattr(name_search.refits, "refit_along_tangent", quick)
    monkeypatch.setattr(name_search.refits, "refit_fully", lambda f, take: f)
    monkeypatch.setattr(name_search, "effects_at_bounds", lambda f, take: ())
    monkeypatch.setattr(name_search.refits, "refit_from_large_sizes", lambda *_: [])
    return offered


def trials(*names: str) -> TrialChanges:
    return TrialChanges(NOTHING, [Trial(name, [], slice(0)) for name in names])


def quietly(text: str) -> None:
    """No report."""


@pytest.mark.parametrize(("nats", "taken"), [(100.0 + GATE + 1.0, True), (100.0 + GATE - 1.0, False)])
def test_a_name_must_add_more_than_the_gate_to_what_a_remainder_explains_already(
    nats: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The likelihood grows by over 100 nats; beside the remainder by just the gate."""
    at = Evidence(monkeypatch, {(): 100.0, ("yaw_scrub",): 0.0})
    offering(monkeypatch, ("yaw_scrub", 90.0), yaw_scrub=nats)
    looking = search()
    looking.trials = trials("yaw_scrub")
    found = looking.add_name(beside(fit(0.0), 100.0), [], quietly)
    assert (found is not None) is taken
    assert looking.refused == ({} if taken else {"yaw_scrub": pytest.approx(GATE - 1.0)})
    assert at.tried_from_rest == [("yaw_scrub",)]  # as it promised far more


def test_what_was_refused_or_is_held_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Evidence(monkeypatch, {})
    offered = offering(monkeypatch, ("rear_toe", 90.0), ("motor_sag", 80.0), rear_toe=5.0, motor_sag=2.0)
    looking = search()
    looking.trials, looking.refused = trials("yaw_scrub", "rear_toe", "motor_sag", "floor_slope"), {"floor_slope": 1.0}
    looking.trials_beside = ("yaw_scrub",)
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


def test_what_explains_most_without_a_remainder_is_refitted_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """If it explains more than chance; nothing is expected of it beside the remainder."""
    names = ["a", "b", "c", "d", "e"]
    Evidence(monkeypatch, {})
    offering(monkeypatch, ("a", 90.0), ("b", 80.0))
    plain = [CandidateEffect(n, [2.0], s) for n, s in (("c", 70.0), ("a", 60.0), ("d", GATE + 1.0), ("e", GATE - 1.0))]
    monkeypatch.setattr(name_search, "screen_effects", lambda f, take, some: plain)
    looking = search()
    looking.trials = trials(*names)
    found = looking._promising(beside(fit(0.0)))
    more = [n for n in ("c", "a", "d")[: SEARCH_LIMITS.plain_candidates] if n != "a"]
    assert [(c.effect, c.score) for c in found] == [("a", 90.0), ("b", 80.0), *((n, 0.0) for n in more)]
    assert [c.values for c in found[2:]] == [[2.0]] * len(more)


def test_trials_and_chance_are_those_beside_the_names_that_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated anew where these change, once, without what is excluded; no trial of what was refused."""
    simulated, drawn = list[tuple[str, ...]](), list[Any]()

    def simulate(f: Any, take: Any) -> TrialChanges:
        simulated.append(f.hypothesis.effects)
        return trials("a", "b", "c", "d")

    def draw(f: Any, take: Any, some: TrialChanges) -> NullGains:
        drawn.append((f, [t.effect for t in some.trials]))
        return chance(GATE + len(drawn))

    monkeypatch.setattr(name_search, "simulate_trials", simulate)
    monkeypatch.setattr(name_search, "sample_null_gains", draw)
    looking = NameSearch(NOTHING, NOTHING, trials("a", "b", "c"), ("d",), (), chance(), {}, {"c": 1.0})
    first, second = beside(fit(0.0)), beside(fit(0.0, "a"))
    for rest in (first, second, second):
        looking.draw_nulls(rest)
    assert simulated == [("a",)]
    assert drawn == [(first.fit, ["a", "b"]), (second.fit, ["b"]), (second.fit, ["b"])]
    assert looking.gate == GATE + 3.0


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
    looking = NameSearch(NOTHING, NOTHING, trials(), ("motor_delay",), (), chance(), {}, {"tyre_relaxation": 1.0})
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
    assert looking._gain(rest, rest, WeighedFit(fit(0.0), 200.0)) == pytest.approx(gain)
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
    looking._gain(full, full, WeighedFit(fit(0.0), nats))
    assert at.copied == ([((), ("fy",))] if needed else [])


def test_what_adds_too_little_anyway_is_not_weighed_against_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    looking, at = keeping(monkeypatch, {}, {})
    full = beside(fit(GATE - 1.0, *A), 200.0, explained(200.0, FULL))
    assert looking._gain(full, full, WeighedFit(fit(0.0), 200.0)) == pytest.approx(GATE - 1.0)
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


# --- from end to end -------------------------------------------------------------------------------------------------


def test_what_is_left_counts_beyond_chance_only() -> None:
    for nats, unknown in ((GATE - 1.0, 0.0), (GATE + 1.0, GATE + 1.0)):
        named = fit(0.0)
        found = Naming(named, named, beside(named), beside(named, nats), {}, {}, (), {}, chance())
        assert found.unknown_nats == unknown
    louder = chance()._replace(placebos=[CandidateEffect("rear_toe", [0.0], GATE + 5.0)])
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


def test_a_constant_law_is_named_though_a_copy_of_it_would_explain_as_much() -> None:
    base, take = concealing(steering_offset=0.0125)
    found = name_effects(base, take)
    assert named_effects(found.best) == ("steering_offset",)
    assert found.gains["steering_offset"] > found.nulls.gate
    value, se = found.best.effect_estimates()["steering_offset__o"]
    assert abs(value - 0.0125) < 4.0 * se


def test_a_friction_that_comes_and_goes_has_no_name() -> None:
    """Functions that turn round where the car does explain it best; no constant friction is named for it."""
    base, take = concealing(180.0, bearing_heat=60.0)
    found = name_effects(base, take)
    assert "rear_rolling_coulomb" not in found.gains
    assert found.unknown_nats > 50.0
    seen = found.before.seen
    assert next(iter(seen.channel_nats())) == "fx"
    size = seen.basis.size.copy()
    size[np.flatnonzero(seen.basis.functions[:, DIRECTION] == DIRECTIONS.index("rolling"))] = 0.0
    less = seen.basis._replace(size=size)
    spread = likeliest_spreads(seen.quadratic, less, less.groups(()), seen.spread)
    whole = seen.quadratic.log_evidence(seen.basis.sd(seen.spread))
    assert whole > seen.quadratic.log_evidence(less.sd(spread)) + 30.0


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

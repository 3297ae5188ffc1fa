"""Effects tried at their sizes: either sign, the promising ones only, from a trusted simulation's own parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from cars import CAR

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.search import line_search, refits
from bcid.diagnosis.search.line_search import (
    COARSE_MULTIPLES,
    SEGMENTS_FOR_EFFECTS,
    SEGMENTS_FOR_SIZES,
    TRIAL_TANGENTS,
    SizedRefit,
    effects_without_place,
    phi_at_reference,
    refit_from_sizes,
    refit_on_whole_take,
    search_sizes,
)
from bcid.effects.constants import Constants
from bcid.effects.corrections import RAW_COMMANDS
from bcid.errors import PredictionDiverged
from bcid.likelihood.hypothesis import Hypothesis

BASE = Hypothesis((), CAR, 2.012, Constants())
SCALES: Any = None


class Segments:
    """A take of which only the segments count."""

    def __init__(self, segments: int) -> None:
        self.segments = segments
        self.length_s = np.full(segments, 90.0)

    def part(self, chosen: np.ndarray) -> Segments:
        return Segments(len(chosen))


@dataclass
class Found:
    """What a refit that moves nothing returns."""

    hypothesis: Hypothesis
    phi: np.ndarray
    start: np.ndarray
    scales: Any
    per_segment: np.ndarray
    log_prior: float = 0.0

    @property
    def log_likelihood(self) -> float:
        return float(self.per_segment.sum())

    @property
    def penalised_log_likelihood(self) -> float:
        return self.log_likelihood + self.log_prior

    def values(self) -> dict[str, float]:
        return self.hypothesis.effect_values(self.phi)


class Refits:
    """Refits by a score of what they hold and where they start."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, score: Any, nothing: float = 0.0) -> None:
        self.made: list[tuple[Found, int, int]] = []  # those that hold an effect
        self._score, self._nothing = score, nothing
        monkeypatch.setattr(line_search, "refit", self)
        monkeypatch.setattr(line_search, "segment_log_likelihoods", lambda *given: self(*given, tangents=0).per_segment)

    def __call__(
        self, take: Any, hypothesis: Hypothesis, phi: Any, start: Any, scales: Any, tangents: int = 99
    ) -> Found:
        if not np.isfinite(start).all():
            raise PredictionDiverged
        held = hypothesis.effects
        score = self._score(held[-1], hypothesis.effect_values(phi), start) if held else self._nothing
        each = np.full(take.segments, score / take.segments) if np.isscalar(score) else np.resize(score, take.segments)
        found = Found(hypothesis, phi, start, scales, each)
        self.made += [(found, take.segments, tangents)] if held else []
        return found


def base_fit(hypothesis: Hypothesis = BASE, values: tuple[float, ...] = ()) -> Any:
    return Found(hypothesis, hypothesis.phi_of(CAR, list(values)), np.zeros((90, 15)), SCALES, np.zeros(90))


def of_size(name: str, field: str, true: float) -> Any:
    """Nats of `name` by how near its value is to the true one, as a ratio; nothing of all others."""

    def score(effect: str, values: dict[str, float], start: Any) -> float:
        return -abs(float(np.log(max(values[field] / true, 1e-9)))) if effect == name else 0.0

    return score


def test_an_effect_of_either_sign_is_tried_with_both_and_the_better_one_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    Refits(monkeypatch, lambda name, values, start: -np.sign(values.get("steering_offset__o", 0.0)))
    fit, names = base_fit(), ["steering_offset", "yaw_scrub"]
    found = search_sizes(fit, Segments(90), fit.phi, names)  # type: ignore[arg-type]
    assert [f.effect for f in found] == ["steering_offset", "yaw_scrub"]
    assert found[0].fit.hypothesis.effect_values(found[0].fit.phi)["steering_offset__o"] < 0.0


def test_what_has_one_sign_is_tried_with_that(monkeypatch: pytest.MonkeyPatch) -> None:
    refits, fit = Refits(monkeypatch, lambda name, values, start: 0.0), base_fit()
    search_sizes(fit, Segments(90), fit.phi, ["yaw_scrub"])  # type: ignore[arg-type]
    assert all(f.values()["yaw_scrub__c"] > 0.0 for f, _, _ in refits.made)


@pytest.mark.parametrize("share", [0.7, 5.0, 44.0])
def test_the_size_from_which_an_effect_is_refitted_is_looked_for(share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small car rolls forty times as heavily, for its mass, as what would just show of the bumper car."""
    own = BASE.entries["rear_rolling_coulomb"].parameters[0]
    true, fit = share * own.size, base_fit()
    assert own.low <= true <= own.high
    refits = Refits(monkeypatch, of_size("rear_rolling_coulomb", "rear_rolling_coulomb__c", true))
    (found,) = search_sizes(fit, Segments(90), fit.phi, ["rear_rolling_coulomb"])  # type: ignore[arg-type]
    value = found.fit.hypothesis.effect_values(found.fit.phi)["rear_rolling_coulomb__c"]
    assert 1.0 / np.sqrt(3.0) < value / true < np.sqrt(3.0)
    assert {(n, tangents) for _, n, tangents in refits.made} == {
        (SEGMENTS_FOR_SIZES, 0),
        (SEGMENTS_FOR_EFFECTS, TRIAL_TANGENTS),
    }


@pytest.mark.parametrize(("worse", "tried"), [((9.0,), 81.0), ((9.0, 27.0), 27.0)])
def test_after_two_sizes_that_are_worse_no_larger_one_is_tried(
    worse: tuple[float, ...], tried: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Large sizes lose segments, which costs most; a single one may have thrown one off."""
    own = BASE.entries["rear_rolling_coulomb"].parameters[0]

    def score(name: str, values: dict[str, float], start: Any) -> float:
        share = values["rear_rolling_coulomb__c"] / own.size
        return -share if any(share == pytest.approx(w) for w in worse) else share

    refits, fit = Refits(monkeypatch, score), base_fit()
    search_sizes(fit, Segments(90), fit.phi, ["rear_rolling_coulomb"])  # type: ignore[arg-type]
    found = [f.values()["rear_rolling_coulomb__c"] for f, _, tangents in refits.made if tangents == 0]
    coarsely = [v for v in found if any(v == pytest.approx(share * own.size) for share in COARSE_MULTIPLES)]
    assert max(coarsely) == pytest.approx(tried * own.size)


def test_where_the_best_size_cannot_be_refitted_the_next_one_is(monkeypatch: pytest.MonkeyPatch) -> None:
    own = BASE.entries["rear_rolling_coulomb"].parameters[0]
    refits, fit = (
        Refits(monkeypatch, of_size("rear_rolling_coulomb", "rear_rolling_coulomb__c", 9.0 * own.size)),
        base_fit(),
    )

    def without_slope(*given: Any, tangents: int) -> Any:
        held = given[1].effect_values(given[2])
        if held and held["rear_rolling_coulomb__c"] == pytest.approx(9.0 * own.size):
            raise PredictionDiverged
        return refits(*given, tangents=tangents)

    monkeypatch.setattr(line_search, "refit", without_slope)
    (found,) = search_sizes(fit, Segments(90), fit.phi, ["rear_rolling_coulomb"])  # type: ignore[arg-type]
    assert found.fit.hypothesis.effect_values(found.fit.phi)["rear_rolling_coulomb__c"] != pytest.approx(9.0 * own.size)


@pytest.mark.parametrize("true", [(0.03, -0.03), (-0.09, 0.0), (0.0, 0.2), (0.03, 0.03), (-0.09, 0.09)])
def test_two_amplitudes_are_tried_each_and_together(true: tuple[float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracked point may be off to the side as well as ahead, or both, either way."""

    def score(name: str, values: dict[str, float], start: np.ndarray) -> float:
        return -float(np.hypot(values["marker_offset__d_x"] - true[0], values["marker_offset__d_y"] - true[1]))

    Refits(monkeypatch, score)
    fit = base_fit()
    (found,) = search_sizes(fit, Segments(90), fit.phi, ["marker_offset"])  # type: ignore[arg-type]
    values = found.fit.hypothesis.effect_values(found.fit.phi)
    off = np.hypot(values["marker_offset__d_x"] - true[0], values["marker_offset__d_y"] - true[1])
    assert off < 0.5 * np.hypot(*true)


def test_no_size_lies_beyond_its_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    own = BASE.entries["tyre_soft_saturation"].parameters[0]
    assert own.size * max(COARSE_MULTIPLES) > own.high
    refits, fit = Refits(monkeypatch, lambda name, values, start: 0.0), base_fit()
    search_sizes(fit, Segments(90), fit.phi, ["tyre_soft_saturation"])  # type: ignore[arg-type]
    tried = [f.values()["tyre_soft_saturation__s"] for f, _, tangents in refits.made if tangents == 0]
    assert max(tried) == own.high
    assert len(set(tried)) == len(tried)


def test_only_the_promising_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    fit = base_fit()
    names = effects_without_place(fit, ())
    worth = {name: 10.0 * k for k, name in enumerate(names)}
    Refits(monkeypatch, lambda name, values, start: worth[name])
    found = search_sizes(fit, Segments(20), fit.phi, names)  # type: ignore[arg-type]
    assert [f.effect for f in found] == list(reversed(names))[: SEARCH_LIMITS.max_sized_effects]


def test_what_suits_its_segments_only_along_further_tangents_is_promising(monkeypatch: pytest.MonkeyPatch) -> None:
    """A size found on FEW segments may lose some of ENOUGH: yaw scrub promised -100 nats at first, 230 later."""
    fit = base_fit()
    names = effects_without_place(fit, ())
    refits = Refits(monkeypatch, lambda name, values, start: 230.0 if name == names[-1] else 0.0)

    def unsettled(*given: Any, tangents: int) -> Any:
        found = refits(*given, tangents=tangents)
        early = tangents < 3 and found.hypothesis.effects == (names[-1],)
        return replace(found, per_segment=found.per_segment - 11.0) if early else found

    monkeypatch.setattr(line_search, "refit", unsettled)
    assert search_sizes(fit, Segments(30), fit.phi, names)[0].effect == names[-1]  # type: ignore[arg-type]


@pytest.mark.parametrize(("nothing", "promise"), [(40.0, 2.0), (-40.0, 42.0)])  # the second refit of it went astray
def test_what_these_segments_gain_with_nothing_more_speaks_for_no_effect(
    nothing: float, promise: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit of the whole take may have left some of its segments short of their best: any refit mends that."""
    Refits(monkeypatch, lambda name, values, start: {"yaw_scrub": 42.0}.get(name, 40.0), nothing)
    fit = base_fit()
    first, _ = search_sizes(fit, Segments(90), fit.phi, ["quadratic_drag", "yaw_scrub"])  # type: ignore[arg-type]
    assert first.effect == "yaw_scrub"
    assert first.promise == pytest.approx(promise - 0.5 * np.log(90.0) / 3.0 - 0.5 * (1.0 - 1.0 / 3.0), abs=0.1)


def test_a_lost_segment_does_not_hide_what_the_others_gain_with_nothing_more(monkeypatch: pytest.MonkeyPatch) -> None:
    lost: Any = np.r_[-5000.0, np.full(29, 10.0)]
    refits = Refits(monkeypatch, lambda name, values, start: np.full(30, 10.0), lost)
    fit = base_fit()
    (found,) = search_sizes(fit, Segments(90), fit.phi, ["yaw_scrub"])  # type: ignore[arg-type]
    assert found.promise < SEARCH_LIMITS.max_segment_nats + 1.0  # for the lost one alone, not for all of them
    assert {t for _, _, t in refits.made if t} == {TRIAL_TANGENTS}


def test_a_lost_segment_does_not_outweigh_all_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    nats = {"yaw_scrub": np.r_[-5000.0, np.full(29, 10.0)], "quadratic_drag": np.ones(30)}
    Refits(monkeypatch, lambda name, values, start: nats[name])
    fit = base_fit()
    found = search_sizes(fit, Segments(30), fit.phi, list(nats))  # type: ignore[arg-type]
    assert [f.effect for f in found] == ["yaw_scrub", "quadratic_drag"]
    assert found[0].fit.penalised_log_likelihood < found[1].fit.penalised_log_likelihood


def test_gains_are_those_of_the_segments_that_were_chosen_and_never_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    fit = base_fit()
    chosen = line_search._spread_segments(Segments(90), SEGMENTS_FOR_EFFECTS)  # type: ignore[arg-type]
    fit.per_segment[chosen] = 1000.0  # all others have none
    nats = {"yaw_scrub": 1100.0, "quadratic_drag": 1120.0, "motor_sag": 1000.0}
    Refits(monkeypatch, lambda name, values, start: np.full(30, nats[name]))
    found = search_sizes(fit, Segments(90), fit.phi, list(nats))  # type: ignore[arg-type]
    assert [f.effect for f in found] == ["quadratic_drag", "yaw_scrub", "motor_sag"]


def test_what_bending_costs_counts_by_the_share_that_was_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A part bends a simulation's parameters as far as the whole does; what that costs is as much less."""
    free, promise = base_fit(), promises_without_a_refit(monkeypatch)
    far = replace(base_fit(BASE.with_effects("yaw_scrub"), (5.0,)), per_segment=np.full(30, 1.0), log_prior=-10.0)
    assert promise(far, free) == pytest.approx(promise(replace(far, log_prior=0.0), free) - 10.0)
    bent = replace(free, log_prior=-60.0)  # what the fit before has paid counts as well
    assert promise(far, bent) == pytest.approx(promise(far, free) + 20.0)
    trusting = BASE.trust_simulation([], 0.02).scale_simulation_prior(1.0 / 3.0)
    stiff, softer = BASE.trust_simulation([], 0.02).prior(free.phi)[1], trusting.prior(free.phi)[1]
    np.testing.assert_allclose(softer, stiff / 3.0)


def promises_without_a_refit(monkeypatch: pytest.MonkeyPatch) -> Any:
    """What a fit of 30 segments promises over one of 90, which no refit to those 30 betters."""

    def astray(*given: Any, **named: Any) -> Any:
        raise PredictionDiverged

    monkeypatch.setattr(line_search, "refit", astray)
    some = np.arange(30)

    def promise(fit: Any, beside: Any) -> float:
        part: Any = Segments(30)
        return line_search._score_refit(
            fit, line_search._fit_null(beside, part, some, beside.hypothesis, beside.phi), 90
        ).promise

    return promise


def test_a_further_effect_is_charged_as_on_the_whole_and_for_suiting_the_chosen_segments(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain, promise = base_fit(), promises_without_a_refit(monkeypatch)
    more = replace(base_fit(BASE.with_effects("yaw_scrub"), (5.0,)), per_segment=np.zeros(30))
    assert promise(more, plain) == pytest.approx(-0.5 * np.log(90.0) / 3.0 - 0.5 * (1.0 - 1.0 / 3.0))
    nothing = line_search._NullFit(np.zeros(30), 0.0)
    assert line_search._score_refit(more, nothing, 30).promise == pytest.approx(
        -0.5 * np.log(30.0)
    )  # there are no others


def test_what_has_a_place_is_found_by_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    names = effects_without_place(base_fit(BASE.with_effects("yaw_scrub"), (10.0,)), ("motor_sag",))
    assert {"rough_patch", "mass_change", "yaw_scrub", "motor_sag"}.isdisjoint(names)
    assert {"steering_offset", "quadratic_drag", "pose_scale"} <= set(names)


def on_a_part(promises: dict[str, tuple[float, float]], sd: float = 0.0) -> list[SizedRefit]:
    """Refits of 30 segments: value and promise by effect."""
    fits: list[Any] = [
        replace(base_fit(BASE.with_effects(name), (v,)), per_segment=np.zeros(30)) for name, (v, _) in promises.items()
    ]
    return [SizedRefit(f, promise, sd) for f, (_, promise) in zip(fits, promises.values(), strict=True)]


def test_on_the_whole_the_first_credible_ones_count(monkeypatch: pytest.MonkeyPatch) -> None:
    fit, low = base_fit(), BASE.entries["steering_offset"].parameters[0].low
    refits = Refits(monkeypatch, lambda name, values, start: 1.0)
    values = {"steering_offset": low, "yaw_scrub": 5.0, "quadratic_drag": 1.0, "motor_sag": 0.1, "rear_toe": 0.01}
    whole = refit_on_whole_take(fit, Segments(90), on_a_part({n: (v, 9.0) for n, v in values.items()}), 0.0)  # type: ignore[arg-type]
    assert [f.hypothesis.effects[-1] for f in whole] == ["yaw_scrub", "quadratic_drag", "motor_sag"]
    assert len(whole) == SEARCH_LIMITS.max_finalists
    assert {segments for _, segments, _ in refits.made} == {90}


@pytest.mark.parametrize(
    ("least", "sd", "refitted"),
    [(0.0, 0.0, ["yaw_scrub", "rear_toe"]), (90.0, 0.0, ["yaw_scrub"]), (300.0, 0.0, []), (300.0, 20.0, ["yaw_scrub"])],
)
def test_what_is_not_likely_to_win_is_not_refitted(
    least: float, sd: float, refitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither what promises little beside the first, nor what is far from what is asked, and not by chance."""
    Refits(monkeypatch, lambda name, values, start: 1.0)
    near, far = 1.2 * SEARCH_LIMITS.likely_share * 20.0, 0.9 * SEARCH_LIMITS.likely_share * 20.0
    promised = {"yaw_scrub": (5.0, 20.0), "rear_toe": (0.01, near), "motor_sag": (0.1, far)}
    if least > 0.0:
        promised["rear_toe"] = (0.01, 0.9 * SEARCH_LIMITS.likely_share * least / 3.0 if least < 100.0 else far)
    whole = refit_on_whole_take(base_fit(), Segments(90), on_a_part(promised, sd), least)  # type: ignore[arg-type]
    assert [f.hypothesis.effects[-1] for f in whole] == refitted


def test_the_whole_is_refitted_under_all_of_a_simulation_s_trust(monkeypatch: pytest.MonkeyPatch) -> None:
    trusting = BASE.trust_simulation([], 0.02)
    fit = base_fit(trusting)
    of_part: Any = replace(
        base_fit(trusting.scale_simulation_prior(1.0 / 3.0).with_effects("yaw_scrub"), (5.0,)), per_segment=np.zeros(30)
    )
    Refits(monkeypatch, lambda name, values, start: 1.0)
    (whole,) = refit_on_whole_take(fit, Segments(90), [SizedRefit(of_part, 9.0, 0.0)], 0.0)  # type: ignore[arg-type]
    assert whole.hypothesis == trusting.with_effects("yaw_scrub")


def test_sizes_are_tried_beside_a_trusted_simulation_s_own_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    trusting = BASE.trust_simulation([], 0.02)
    bent: Any = base_fit(trusting)
    bent.phi[:3] += 0.4
    refits = Refits(monkeypatch, lambda name, values, start: 30.0)
    whole, names = refit_from_sizes(bent, Segments(90), ["yaw_scrub"], 0.0)  # type: ignore[arg-type]
    assert names == ("yaw_scrub",)
    assert len(whole) == 1
    tried = [f for f, _, tangents in refits.made if tangents == 0]
    assert tried
    assert trusting.trusted_simulation is not None
    assert all((f.phi[: len(trusting.trusted_simulation.phi)] == trusting.trusted_simulation.phi).all() for f in tried)
    held: Any = base_fit(trusting.with_effects("yaw_scrub"), (5.0,))
    assert refit_from_sizes(held, Segments(90), ["yaw_scrub"], 0.0) == ([], ())  # type: ignore[arg-type]


def test_a_trusted_simulation_s_parameters_leave_what_was_found_alone() -> None:
    trusting = BASE.trust_simulation([], 0.02).with_effects("yaw_scrub")
    assert trusting.trusted_simulation is not None
    bent: Any = base_fit(trusting, (7.0,))
    bent.phi[:3] += 0.4
    phi = phi_at_reference(bent)
    np.testing.assert_array_equal(phi[: len(trusting.trusted_simulation.phi)], trusting.trusted_simulation.phi)
    assert trusting.effect_values(phi)["yaw_scrub__c"] == pytest.approx(7.0)


@pytest.mark.parametrize(("known", "g"), [({}, 0.2), ({"steering_scale": 0.04}, 0.0)])
def test_a_gain_of_raw_commands_is_a_simulation_s_own_where_it_was_measured(known: dict[str, float], g: float) -> None:
    raw = replace(BASE, assumed=("motor_lag", *RAW_COMMANDS), raw_commands=True).trust_simulation(
        [0.06, 0.0], 0.02, known
    )
    bent: Any = base_fit(raw.with_effects("yaw_scrub"), (0.5, 0.2, 7.0))
    values = raw.with_effects("yaw_scrub").effect_values(phi_at_reference(bent))
    assert values == pytest.approx({"motor_lag__tau": 0.06, "steering_scale__g": g, "yaw_scrub__c": 7.0})


def test_what_a_base_model_assumes_may_end_where_it_will() -> None:
    """A simulation's own offset at its bound silences nothing else; the same offset as an explanation is none."""
    low = BASE.entries["steering_offset"].parameters[0].low
    held: Any = base_fit(BASE.with_effects("steering_offset", "yaw_scrub"), (low, 5.0))
    take: Any = Segments(90)
    assert refits.effects_at_bounds(held, take) == ("steering_offset",)
    assumed = replace(BASE, assumed=("steering_offset",)).with_effects("yaw_scrub")
    assert not refits.effects_at_bounds(base_fit(assumed, (low, 5.0)), take)

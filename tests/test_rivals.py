"""What stands beside a fit: one rival for each exchange, none for what is held already, and exchanges that win."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR
from concealed import record_case

from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.diagnosis.judge import held_out
from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.search import rivals
from bcid.diagnosis.search.corrections import COMMAND_DELAYS, is_certain, replace_delays_by_latency
from bcid.diagnosis.search.refits import effects_at_bounds, named_effects
from bcid.diagnosis.search.rivals import distinct_rivals, exchange_until_stable, leave_one_out, look_alikes
from bcid.diagnosis.search.screen import CandidateEffect
from bcid.effects.constants import Constants
from bcid.effects.table import ENTRIES
from bcid.errors import PredictionDiverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.refit import Fit
from bcid.likelihood.refit_state import Tangent
from bcid.likelihood.score_test import Trial, TrialChanges
from bcid.proof.blind.blind_test import BlindTest, SuiteSizes

TAKE: Any = None


def fit(penalised_log_likelihood: float, *effects: str) -> Any:
    return SimpleNamespace(
        hypothesis=SimpleNamespace(effects=effects, assumed=()), penalised_log_likelihood=penalised_log_likelihood
    )


def test_a_rival_has_one_effect_in_place_of_another() -> None:
    best = fit(100.0, "yaw_scrub", "rear_toe")
    better, worse = fit(95.0, "rear_toe", "yaw_coulomb"), fit(90.0, "yaw_coulomb", "rear_toe")
    fewer, more = fit(99.0, "yaw_scrub"), fit(99.0, "yaw_scrub", "rear_toe", "motor_sag")
    same, other = fit(99.5, "rear_toe", "yaw_scrub"), fit(99.0, "motor_sag", "yaw_coulomb")
    assert distinct_rivals(best, [worse, better, fewer, more, same, other]) == (better,)


def beside(monkeypatch: pytest.MonkeyPatch, exchanges: dict[tuple[str, ...], list[Any]]) -> None:
    """Refits that need no take: `exchanges` of a fit by its effects, best first."""
    monkeypatch.setattr(rivals, "leave_one_out", lambda f, known, take: dict.fromkeys(f.hypothesis.effects))
    monkeypatch.setattr(rivals, "_refit_exchanges", lambda f, *_: exchanges[f.hypothesis.effects])
    monkeypatch.setattr(rivals, "refine_places", lambda f, take: f)


def test_an_exchange_that_wins_is_exchanged_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, third = fit(10.0, "a", "b"), fit(20.0, "a", "c"), fit(30.0, "d", "c")
    stale = fit(9.0, "e", "b")  # beside the first one alone
    beside(
        monkeypatch, {("a", "b"): [second, stale], ("a", "c"): [third, first], ("d", "c"): [second, fit(5.0, "d", "f")]}
    )
    found = exchange_until_stable(first, TAKE, TAKE, ())
    assert found.best is third
    assert [f.hypothesis.effects for f in found.rivals] == [("a", "c"), ("d", "f")]


def test_half_a_take_bends_a_trusted_simulation_as_far_as_the_whole_does(monkeypatch: pytest.MonkeyPatch) -> None:
    trusting = Hypothesis((), CAR, 2.012, Constants(), assumed=("motor_lag",)).trust_simulation([0.06], 0.02)
    take: Any = SimpleNamespace(segments=4, rows=lambda chosen: chosen, part=lambda chosen: None)
    made = list[Any]()
    monkeypatch.setattr(held_out, "refit", lambda part, hypothesis, *_: made.append(hypothesis))
    nothing: Any = np.zeros((4, 1))
    whole = Fit(trusting, nothing, nothing, nothing, 0.0, nothing, nothing, Tangent(nothing, nothing))
    held_out.refit_on_half(whole, take, np.array([0, 2]))
    phi = trusting.with_effects().phi_of(CAR, [0.06])
    half, full = (h.with_effects().prior(phi) for h in (made[0], trusting))
    off = phi + np.random.default_rng(5).normal(0.0, 0.1, len(phi))
    assert half.log_density(off) == pytest.approx(0.5 * full.log_density(off))
    assert full.log_density(off) < 0.0


def test_half_a_take_that_leads_astray_is_judged_by_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """What half a take makes of a poor explanation may not even drive the other half."""
    take = SimpleNamespace(segments=4, begin_s=np.array([0.0, 1.0, 2.0, 3.0]), T=12.0)
    stays = SimpleNamespace(phi=np.zeros(1), scales="of the whole")

    def on(fit: Any, take: Any, chosen: Any, phi: Any, scales: Any) -> Any:
        if scales == "of half" and 0 in chosen:
            raise PredictionDiverged("a prediction left the finite numbers")
        return np.full(len(chosen), -1.0 if scales == "of half" else -2.0)

    monkeypatch.setattr(held_out, "refit_on_half", lambda *_: SimpleNamespace(phi=np.ones(1), scales="of half"))
    monkeypatch.setattr(held_out, "_evaluate_segments", on)
    found = held_out.held_out_log_likelihoods(stays, take)  # type: ignore[arg-type]
    assert sorted(found) == [-2.0, -2.0, -1.0, -1.0]
    assert found[0] == -2.0


def test_a_trusted_simulation_s_figures_speak_on_every_block() -> None:
    take: Any = SimpleNamespace(begin_s=np.arange(0.0, 240.0, 1.5), T=240.0)
    scatter = np.random.default_rng(3).standard_normal(160)
    plain, bent = (held_out.bootstrap_gain(scatter, np.zeros(160), take, unbent) for unbent in (0.0, 50.0))
    assert bent.nats == pytest.approx(plain.nats + 50.0)
    assert np.subtract(bent.ci95, plain.ci95) == pytest.approx([50.0, 50.0])


@pytest.mark.parametrize(("field", "share", "there"), [("d_y", 1.0, False), ("d_y", 0.9, True), ("d_x", -1.0, False)])
def test_a_size_at_the_end_of_its_range_is_no_car_s(field: str, share: float, there: bool) -> None:
    """Tracked points do not lie beyond the car; a friction that falls to nothing is at its natural end."""
    hypothesis = Hypothesis((), CAR, 2.012, Constants()).with_effects("marker_offset", "tyre_soft_saturation")
    entries = {p.symbol: p for n in hypothesis.effects for p in hypothesis.entries[n].parameters}
    values = {"d_x": 0.0, "d_y": 0.0, "s": entries["s"].high} | {field: share * entries[field].high}
    phi = hypothesis.phi_of(CAR, [values[p.symbol] for _, p in hypothesis.effect_parameters])
    take = SimpleNamespace(length_s=[60.0])
    fit = SimpleNamespace(hypothesis=hypothesis, phi=phi)
    assert effects_at_bounds(fit, take) == (() if there else ("marker_offset",))  # type: ignore[arg-type]


@pytest.mark.parametrize(("t_s", "there"), [(1.0, False), (9.8, False), (30.0, True), (590.0, False), (300.0, True)])
def test_a_change_at_an_end_of_the_take_is_none(t_s: float, there: bool) -> None:
    """Mass 'lost' in the first seconds is another car's for the rest: parameters bent past what is trusted of them.

    What a few segments are like by themselves is no change, either.
    """
    hypothesis = Hypothesis((), CAR, 2.012, Constants()).with_effects("mass_change")
    fit = SimpleNamespace(hypothesis=hypothesis, phi=hypothesis.phi_of(CAR, [-0.2, t_s]))
    begin_s = np.arange(0.0, 60.0, 1.5) if t_s < 60.0 else np.r_[0.0:600.0:1.5, 2000.0:2300.0:1.5]
    take = SimpleNamespace(begin_s=begin_s, zero_s=np.where(begin_s < 2000.0, 0.0, 2000.0), segments=len(begin_s))
    assert effects_at_bounds(fit, take) == (() if there else ("mass_change",))  # type: ignore[arg-type]


def test_what_was_fitted_already_is_not_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[tuple[str, ...]]()

    def refitted(fit: Any, take: Any, effects: tuple[str, ...]) -> str:
        asked.append(effects)
        return "refitted"

    monkeypatch.setattr(rivals.refits, "refit_with_effects", refitted)
    best, known = fit(100.0, "tyre_fall", "yaw_scrub", "rear_toe"), fit(50.0, "tyre_fall", "yaw_scrub")
    assert leave_one_out(best, [fit(1.0), known], TAKE) == {"yaw_scrub": "refitted", "rear_toe": known}
    assert asked == [("tyre_fall", "rear_toe")]  # a correction stays, and is no name


@pytest.mark.parametrize(("score", "tried"), [(1.05, True), (0.95, False)])
def test_an_effect_is_exchanged_for_what_may_explain_a_fair_share_of_it(
    score: float, tried: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What explains a share of what is lost without the name is tried, if among the first; look-alikes always are."""
    held, less = fit(100.0, "yaw_scrub", "motor_sag"), fit(20.0, "motor_sag")
    near = 80.0 * SEARCH_LIMITS.near_best_share
    names = ["yaw_coulomb", "rear_toe", "floor_slope", "quadratic_drag"]
    offered = list[str]()

    def screened(fit: Any, take: Any, trials: TrialChanges) -> list[CandidateEffect]:
        offered.extend(t.effect for t in trials.trials)
        return [CandidateEffect(name, [1.0], score * near - 0.01 * k) for k, name in enumerate(names)]

    monkeypatch.setattr(rivals, "screen_effects", screened)
    monkeypatch.setattr(
        rivals.refits, "refit_along_tangent", lambda f, take, c: fit(90.0, *f.hypothesis.effects, c.effect)
    )
    monkeypatch.setattr(rivals.refits, "refit_fully", lambda f, take: f)
    monkeypatch.setattr(rivals.refits, "rank_credible_fits", lambda fits, take: list(fits))
    trials = TrialChanges(np.zeros(0), [Trial(name, [], slice(0)) for name in ("yaw_scrub", "motor_sag", *names)])
    found = rivals._refit_exchanges(held, TAKE, trials, {"yaw_scrub": less})
    promising = names[: SEARCH_LIMITS.max_exchanges] if tried else []
    alike = [name for name in ("yaw_coulomb", "quadratic_drag") if name not in promising]
    assert [f.hypothesis.effects for f in found] == [("motor_sag", name) for name in (*promising, *alike)]
    assert offered == names  # what is held comes in no second time


def test_looks_are_mutual() -> None:
    """A steering lag looks like a delay, and so does the delay like the lag, whichever entry of the table says so."""
    assert "pose_latency" in look_alikes("steering_delay")
    assert "steering_delay" in look_alikes("pose_latency")
    assert all(name in look_alikes(other) for name in ENTRIES for other in look_alikes(name))


def test_an_exchange_that_a_quick_refit_leads_astray_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    held, less = fit(100.0, "yaw_scrub"), fit(20.0)
    monkeypatch.setattr(rivals, "screen_effects", lambda *_: [CandidateEffect("rear_toe", [0.5], 1e6)])
    monkeypatch.setattr(rivals.refits, "refit_along_tangent", lambda f, take, c: fit(95.0, c.effect))
    monkeypatch.setattr(rivals.refits, "refit_fully", lambda f, take: fit(-2900.0, *f.hypothesis.effects))
    monkeypatch.setattr(
        rivals.refits, "refit_with_effects", lambda f, take, effects, sizes: fit(90.0 + sizes[0], *effects)
    )
    monkeypatch.setattr(rivals.refits, "rank_credible_fits", lambda fits, take: list(fits))
    (found,) = rivals._refit_exchanges(held, TAKE, TrialChanges(np.zeros(0), []), {"yaw_scrub": less})
    assert (found.hypothesis.effects, found.penalised_log_likelihood) == (("rear_toe",), 90.5)


def test_an_exchange_that_diverges_or_is_no_car_s_is_no_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    held, less = fit(100.0, "yaw_scrub"), fit(20.0)
    sizes = {"rear_toe": 90.0, "floor_slope": 80.0, "yaw_coulomb": None}
    monkeypatch.setattr(rivals, "screen_effects", lambda *_: [CandidateEffect(name, [1.0], 1e6) for name in sizes])

    def quick(f: Any, take: Any, c: CandidateEffect) -> Any:
        if sizes[c.effect] is None:
            raise PredictionDiverged
        return fit(sizes[c.effect], c.effect)

    def diverge(*_: Any) -> None:
        raise PredictionDiverged

    monkeypatch.setattr(rivals.refits, "refit_along_tangent", quick)
    monkeypatch.setattr(rivals.refits, "refit_with_effects", diverge)
    monkeypatch.setattr(rivals.refits, "refit_fully", lambda f, take: f)
    monkeypatch.setattr(
        rivals.refits,
        "effects_at_bounds",
        lambda f, take: f.hypothesis.effects if "rear_toe" in f.hypothesis.effects else (),
    )
    found = rivals._refit_exchanges(held, TAKE, TrialChanges(np.zeros(0), []), {"yaw_scrub": less})
    assert [f.hypothesis.effects for f in found] == [("floor_slope",)]


# --- corrections ----------------------------------------------------------------------------------------------------


def estimated(**estimates: tuple[float, float]) -> Any:
    return SimpleNamespace(effect_estimates=lambda: estimates)


def test_a_correction_is_certain_far_from_zero_only() -> None:
    far = SEARCH_LIMITS.certain_se
    assert is_certain(estimated(tyre_fall__f=(1.01 * far * 0.1, 0.1)), "tyre_fall")
    assert not is_certain(estimated(tyre_fall__f=(0.99 * far * 0.1, 0.1)), "tyre_fall")
    assert is_certain(estimated(slip_speed__d=(-1.01 * far * 0.1, 0.1)), "slip_speed")
    assert not is_certain(estimated(tyre_fall__f=(5.0, 0.0)), "tyre_fall")  # nothing was found of it


@pytest.mark.parametrize(("late_nats", "replaced"), [(101.0, True), (99.0, False)])
def test_two_delays_are_one_of_the_pose_where_that_is_likelier(
    late_nats: float, replaced: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[tuple[tuple[str, ...], list[float]]]()

    def refitted(fit_: Any, take: Any, effects: tuple[str, ...], added: list[float]) -> Any:
        asked.append((effects, added))
        return fit(late_nats, *effects)

    monkeypatch.setattr("bcid.diagnosis.search.corrections.refit_with_effects", refitted)
    both = fit(100.0, "steering_delay", "yaw_scrub", "motor_delay")
    both.effect_estimates = lambda: {"steering_delay__tau": (0.010, 1e-3), "motor_delay__tau": (0.014, 1e-3)}
    found = replace_delays_by_latency(both, TAKE)
    assert named_effects(found) == (("yaw_scrub", "pose_latency") if replaced else named_effects(both))
    ((effects, (tau,)),) = asked
    assert effects == ("yaw_scrub", "pose_latency")
    assert tau == pytest.approx(0.012)
    for others in (("steering_delay",), COMMAND_DELAYS[1:], (*COMMAND_DELAYS, "pose_latency"), ()):
        alone = fit(100.0, *others)
        assert replace_delays_by_latency(alone, TAKE) is alone


# --- sizes that a car may have ---------------------------------------------------------------------------------------


def test_what_a_base_model_assumes_may_end_where_it_will() -> None:
    """A simulation's own offset at its bound silences nothing else; the same offset as an explanation is none."""
    base, take = Hypothesis((), CAR, 2.012, Constants()), SimpleNamespace(length_s=[60.0])
    low = base.entries["steering_offset"].parameters[0].low
    for assumed, there in (((), ("steering_offset",)), (("steering_offset",), ())):
        h = replace(base, assumed=assumed).with_effects(
            *(n for n in ("steering_offset", "yaw_scrub") if n not in assumed)
        )
        values = {"steering_offset__o": low, "yaw_scrub__c": 5.0}
        phi = h.phi_of(CAR, [values[field] for field, _ in h.effect_parameters])
        found: Any = SimpleNamespace(hypothesis=h, phi=phi)
        assert effects_at_bounds(found, take) == there  # type: ignore[arg-type]


@pytest.mark.slow
def test_poses_of_a_tricycle_that_come_late_are_not_told_as_late_steering_alone() -> None:
    """Its measured wheel speed may be early or late as well, at whose bound a score test sees no rival."""
    cases = BlindTest(2408849165, "", False, SuiteSizes(every=6)).cases
    case = next(c for c in cases if c.name == "tricycle-1444")
    drive = record_case(case)
    diagnosis = diagnose_recordings([drive.recording], [drive.estimate], drive.vehicle, reference=drive.reference)
    (found,) = diagnosis.judgement.findings
    assert "pose_latency" in (found.effect, *found.twins)

"""Derivatives of predicted poses by the variational equation, against complex steps and central differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from cars import CAR

from bcid.effects.constants import Constants
from bcid.effects.table import ANY_ON_BODY, BESIDE_BODY, ENTRIES, OFF, effect_switches
from bcid.estimate.types import Estimate
from bcid.likelihood import newton, nuisance
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.jacobian import changed_cars, parameter_jacobian
from bcid.likelihood.lane_rollout import SegmentLayout, segment_layout
from bcid.likelihood.newton import tangent_at
from bcid.likelihood.nuisance import linearise_residuals, pose_residuals
from bcid.likelihood.predict import COARSE, FINE, linearise_poses, predict_poses
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.refit_state import RefitProblem
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START, Take, cut_segments
from bcid.recording.types import Recording

BASE = Hypothesis((), CAR, 2.012, Constants())
SCALES = Scales(np.array([5e-4, 5e-4, 1e-3]), np.array([0.1, 0.1, 0.1]))


@pytest.fixture(scope="module")
def part(recording: Recording, estimate: Estimate) -> Take:
    """Segments with full lock, reversing and the patch among them; more than fill a vector."""
    take = cut_segments(recording, estimate)
    return take.part(np.arange(4, 32, 2))


@pytest.fixture(scope="module")
def estimate(recording: Recording, vehicle: Any, tuning: Any) -> Estimate:
    from bcid.estimate.run import estimate_motion

    return estimate_motion(recording, vehicle, tuning)


def shove(take: Take) -> np.ndarray:
    """The take's nuisance parameters (S, N_NUISANCE) with pushes of about 0.3 m/s^2 and 1 rad/s^2."""
    start = take.start.copy()
    q = np.tile([0.3, 0.3, 1.0], KNOTS)
    start[:, N_START:] = np.random.default_rng(4).standard_normal((take.segments, 3 * KNOTS)) * q
    return start


# --- the base car, written anew for complex numbers ---------------------------------------------------------------


def clip(x: complex, high: complex, low: complex | None = None) -> complex:
    """`x` between `low` (-high) and `high` by real parts."""
    low = -high if low is None else low
    return low if x.real < low.real else high if x.real > high.real else x


def rate(x: np.ndarray, delta: complex, u: tuple[float, float, float], push: np.ndarray, p: Any) -> np.ndarray:
    """Rates of [x, y, theta, v_x, v_y, omega] of a front-driven car at the angle `delta`; `u` = throttles, weight."""
    _, _, theta, v_x, v_y, w = x
    c, s = np.cos(delta), np.sin(delta)
    across = v_y + p["l_f"] * w
    along_f, across_f = c * v_x + s * across, c * across - s * v_x
    size = along_f if along_f.real >= 0.0 else -along_f

    def slip(along: complex, across: complex) -> complex:
        fast = along if along.real >= 0.0 else -along
        return np.arctan(across / (fast if fast.real > p["v_0"].real else p["v_0"]))

    def motor(u_m: float) -> complex:
        if u_m < 0.0:
            return clip(u_m * p["K_b"] * along_f, p["F_m_max"])
        return clip(p["K_t"] * (u_m - along_f), p["F_m_max"], 0.0 + 0.0j)

    F_l = motor(u[0]) + u[2] * (motor(u[1]) - motor(u[0])) - p["R_1"] * along_f - p["R_2"] * along_f * size
    F_f = clip(-p["C_f"] * slip(along_f, across_f), p["F_f_max"])
    F_r = clip(-p["C_r"] * slip(v_x, v_y - p["l_r"] * w), p["F_r_max"])
    side = s * F_l + c * F_f
    return np.array([
        np.cos(theta) * v_x - np.sin(theta) * v_y, np.sin(theta) * v_x + np.cos(theta) * v_y, w,
        (c * F_l - s * F_f) / p["m"] + w * v_y + push[0], (side + F_r) / p["m"] - w * v_x + push[1],
        (p["l_f"] * side - p["l_r"] * F_r) / p["I_z"] + push[2],
    ])  # fmt: skip


class Instant(NamedTuple):
    """What the actuators give at a stage: mean throttle, steering angle and its rate, time of the recording."""

    u_m: float
    delta: float
    delta_rate: float
    t: float
    u: tuple[float, float, float]  # both throttles, and the weight of the second
    step: int  # of the actuator chain


def instant(inputs: PredictionInputs, k: int, stage: int) -> Instant:
    """What the actuators give at the beginning, in the middle or at the end (`stage` 0 to 2) of step `k`."""
    chain, s = inputs.chain, inputs.chain.late[k]
    weight = (3 * s * s - 2 * s, s, 4 * s - 3 * s * s)[stage]
    u, delta = (chain.u_m[k], chain.u_next[k], weight), chain.delta[2 * k : 2 * k + 3]
    t = chain.t_0 + (k + 0.5 * stage) * chain.h
    return Instant(u[0] + weight * (u[1] - u[0]), delta[stage], (delta[2] - delta[0]) / chain.h, t, u, k)


Rest = Callable[[np.ndarray, Instant, Any], tuple[complex, np.ndarray]]


def nothing_more(_state: np.ndarray, _now: Instant, _p: Any) -> tuple[complex, np.ndarray]:
    """How far the wheel is turned further, and accelerations that are added."""
    return 0.0j, np.zeros(3)


def drive(
    x: np.ndarray, inputs: PredictionInputs, step: int, steps: int, p: Any, rest: Rest = nothing_more
) -> np.ndarray:
    """Poses (steps + 1, 3) from the nuisance parameters `x` (N_NUISANCE,), by RK4, of complex numbers."""
    h = inputs.chain.h
    state, path = x[:N_START], [x[:3]]

    def rate_at(state: np.ndarray, now: Instant, push: np.ndarray) -> np.ndarray:
        turn, more = rest(state, now, p)
        return rate(state, now.delta + turn, now.u, push + more, p)

    for i in range(steps):
        begin, middle, end = (instant(inputs, step + i, stage) for stage in range(3))
        push = x[N_START:].reshape(KNOTS, 3)[i // (steps // KNOTS)]
        k1 = rate_at(state, begin, push)
        k2 = rate_at(state + 0.5 * h * k1, middle, push)
        k3 = rate_at(state + 0.5 * h * k2, middle, push)
        k4 = rate_at(state + h * k3, end, push)
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        path.append(state[:3])
    return np.array(path)


def at_steps(take: Take, layout: SegmentLayout) -> SegmentLayout:
    """The layout with a pose at every integration step but the first, each a row of its own."""
    n = take.steps * take.segments
    stamp = (take.step[:, None] + np.arange(1, take.steps + 1)) * take.h
    first = np.arange(take.segments + 1) * take.steps
    return layout._replace(stamp_s=stamp.ravel(), row=np.arange(n), share=np.ones(n), first_stamp=first, first=first)


def test_derivatives_are_complex_steps_of_the_car_written_anew(part: Take) -> None:
    """By the state, pushes and every constant of the base car: equations of the test's own, and no differences."""
    few, phi = part.part(np.arange(0, part.segments, 2)), BASE.phi_of(CAR)
    inputs, start, tiny = BASE.prediction_inputs(phi, few), shove(few), 1e-30
    cars, widths = changed_cars(BASE, phi)
    chain, _, e, c = inputs.kernel_arguments
    poses, derivatives, _ = linearise_poses(
        at_steps(few, segment_layout(few)), start, chain, cars, widths, COARSE, e, c
    )
    plain = {s: complex(v) for s, v in CAR._asdict().items()}
    names = BASE.parameter_names
    for s in range(few.segments):
        mine, where = slice(s * few.steps, (s + 1) * few.steps), (int(few.step[s]), few.steps)
        expected = np.empty((few.steps, 3, N_NUISANCE + len(names)))
        for j in range(N_NUISANCE):
            moved = start[s] + 1j * tiny * np.eye(N_NUISANCE)[j]
            path = drive(moved, inputs, *where, plain)
            expected[:, :, j] = path[1:].imag / tiny
        for j, name in enumerate(names):
            unit = BASE.drag_units[("R_1", "R_2").index(name)] if name in ("R_1", "R_2") else plain[name].real
            changed = plain | {name: plain[name] + 1j * tiny * unit}
            path = drive(start[s].astype(complex), inputs, *where, changed)
            expected[:, :, N_NUISANCE + j] = path[1:].imag / tiny
        np.testing.assert_allclose(poses[mine], path[1:].real, rtol=0.0, atol=1e-9)
        size = np.abs(expected).max(axis=(0, 1))
        by_state, by_car, by_pushes = np.split(derivatives[mine], [N_START, N_START + len(names)], axis=2)
        error = np.abs(np.concatenate([by_state, by_pushes, by_car], axis=2) - expected)
        assert (error.max(axis=(0, 1)) <= 2e-5 * size + 1e-9).all()


def test_rows_of_segments_side_by_side_lie_wherever_they_do(part: Take) -> None:
    """A row counts as soon as all segments beside each other have reached theirs; gaps in one are no other's."""
    few = part.part(np.arange(0, part.segments, 2))
    inputs, start = BASE.prediction_inputs(BASE.phi_of(CAR), few), shove(few)
    cars, widths = changed_cars(BASE, BASE.phi_of(CAR))
    chain, _, e, c = inputs.kernel_arguments
    whole = at_steps(few, segment_layout(few))
    expected = linearise_poses(whole, start, chain, cars, widths, FINE, e, c)
    rng, n = np.random.default_rng(8), few.steps
    kept = [np.arange(n), np.arange(n - 3, n), np.arange(3), np.arange(7, 8)]
    kept += [np.flatnonzero(rng.uniform(size=n) < 0.2) for _ in range(few.segments - len(kept))]
    rows = np.concatenate([s * n + own for s, own in enumerate(kept)])
    first = np.r_[0, np.cumsum([len(own) for own in kept])]
    layout = whole._replace(
        stamp_s=whole.stamp_s[rows], row=np.arange(len(rows)), share=np.ones(len(rows)), first_stamp=first, first=first
    )
    poses, derivatives, along = linearise_poses(layout, start, chain, cars, widths, FINE, e, c)
    np.testing.assert_allclose(poses, expected[0][rows], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(derivatives, expected[1][rows], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(along, expected[2])


SMOOTH = {
    "motor_lag": (0.08,), "tyre_relaxation": (0.2,), "floor_slope": (0.2, -0.1), "mass_change": (0.2, 30.0),
    "marker_offset": (0.1, 0.05), "pose_scale": (0.1,), "friction_circle": (1.0,), "load_transfer": (0.1,),
    "steering_compliance": (9e-5,), "steering_speed_gain": (0.05,), "motor_sag": (0.3,), "drive_lateral_offset": (0.1,),
    "motor_lag tyre_relaxation floor_slope": (0.08, 0.2, 0.2, -0.1),
}  # fmt: skip


@pytest.mark.parametrize("names", SMOOTH)
def test_derivatives_are_central_differences_whatever_the_effect(part: Take, names: str) -> None:
    hypothesis = BASE.with_effects(*names.split())
    phi = hypothesis.phi_of(CAR, SMOOTH[names])
    inputs, start, layout = hypothesis.prediction_inputs(phi, part), shove(part), segment_layout(part)
    found, h = linearise_residuals(part, inputs, start, changed_cars(hypothesis, phi)), 1e-5
    columns = []
    for step in h * np.eye(N_NUISANCE):
        up, down = (predict_poses(layout, start + sign * step, *inputs.kernel_arguments) for sign in (1.0, -1.0))
        columns.append((up - down) / (2.0 * h))
    for step in h * np.eye(hypothesis.size)[: hypothesis.base_size]:
        up, down = (
            predict_poses(layout, start, *hypothesis.prediction_inputs(phi + sign * step, part).kernel_arguments)
            for sign in (1.0, -1.0)
        )
        columns.append((up - down) / (2.0 * h))
    expected = np.stack(columns, axis=2)
    error = np.abs(np.concatenate([found.A, found.J], axis=2) - expected)
    size = np.maximum(np.abs(expected).max(axis=(0, 1)), 1e-9)
    assert np.quantile(error / size, 0.98) < 2e-5  # a kink within a difference is none of these
    assert np.median((error / size).max(axis=(0, 1))) < 1e-3


def test_residuals_come_along(part: Take) -> None:
    inputs = BASE.prediction_inputs(BASE.phi_of(CAR), part)
    start = shove(part)
    np.testing.assert_allclose(
        linearise_residuals(part, inputs, start).r, pose_residuals(part, inputs, start), rtol=0.0, atol=1e-12
    )


def test_a_prediction_is_not_made_twice(part: Take, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is one taken for another: what differs in a pose, a pose's time, a switch or a start is computed anew."""
    made = []

    def counted(*given: Any) -> np.ndarray:
        made.append(given)
        return np.asarray(predict_poses(*given))

    monkeypatch.setattr(nuisance, "predict_poses", counted)
    few, on = part.part(np.array([1, 2])), BASE.with_effects("yaw_scrub")
    inputs, start = BASE.prediction_inputs(BASE.phi_of(CAR), few), shove(few)
    first = pose_residuals(few, inputs, start)
    np.testing.assert_array_equal(pose_residuals(few, inputs, start.copy()), first)
    elsewhere = pose_residuals(few._replace(pose=few.pose + 0.1), inputs, start)
    np.testing.assert_allclose(elsewhere, first + 0.1, rtol=0.0, atol=1e-12)
    assert len(made) == 1
    others = [
        pose_residuals(few._replace(stamp_s=few.stamp_s + 0.01), inputs, start),
        pose_residuals(few, on.prediction_inputs(on.phi_of(CAR, (50.0,)), few), start),
        pose_residuals(few, BASE.prediction_inputs(BASE.phi_of(CAR._replace(C_f=4000.0)), few), start),
        pose_residuals(few, inputs, start + 1e-9),
    ]
    assert len(made) == 1 + len(others)
    assert not any(np.array_equal(other, first) for other in others)
    for k in range(2 * nuisance.RECENT_PREDICTIONS):
        pose_residuals(few, inputs, start + 1e-3 * k)
    assert len(nuisance._RECENT) <= nuisance.RECENT_PREDICTIONS


def test_a_tangent_is_what_differences_of_predictions_say(part: Take) -> None:
    """By an unknown servo's parameters, too."""
    unknown = replace(BASE, unknown_steering=("T_s", "d"))
    problem, phi = RefitProblem(part, unknown, unknown.prior(unknown.phi_of(CAR))), unknown.phi_of(CAR)
    state = newton.evaluate_at(problem, phi, part.start, SCALES)
    tangent = tangent_at(problem, state)
    differences = parameter_jacobian(part, unknown, phi, state.start, state.r, range(unknown.base_size))
    size = np.maximum(np.abs(differences).max(axis=(0, 1)), 1e-9)
    assert np.quantile(np.abs(tangent.J - differences) / size, 0.95) < 2e-3


# --- the base car without switches --------------------------------------------------------------------------------


def test_the_switches_say_whether_anything_acts_on_the_body() -> None:
    assert set(BESIDE_BODY) <= set(ENTRIES)
    assert getattr(effect_switches(), ANY_ON_BODY) == 0.0
    for name, e in ENTRIES.items():
        field = e.fields[0]
        on = effect_switches({field: OFF[field] + 0.1})
        assert getattr(on, ANY_ON_BODY) == float(name not in BESIDE_BODY)


def test_a_car_without_effects_asks_for_no_switch(part: Take) -> None:
    """The same path, to the last bit, as with all switches asked for and off."""
    inputs = BASE.prediction_inputs(BASE.phi_of(CAR), part)
    asking = inputs.switches.copy()
    asking[ANY_ON_BODY] = 1.0
    poses = [
        predict_poses(segment_layout(part), shove(part), *each.kernel_arguments)
        for each in (inputs, inputs._replace(switches=asking))
    ]
    np.testing.assert_allclose(*poses, rtol=0.0, atol=1e-12)

"""Basis functions of the state that may act on the body, at every place where physics may be missing.

Each acts in one direction: along or across a wheel, along the body, over the floor, about the yaw axis, or as a turn
of the steered wheel.
"""

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline, njit_parallel
from bcid.diagnosis.locate.pushes import driving_force
from bcid.diagnosis.locate.scan_statistic import FloorCircle
from bcid.effects.actuators import ActuatorChain, actuation_at
from bcid.effects.car import Actuation, BodyState, unpack_body, unpack_lags, wrench_with_effects
from bcid.effects.constants import Constants
from bcid.effects.motion import integrate_body
from bcid.effects.tyres import tyre_soft_saturation
from bcid.likelihood.lane_rollout import (
    SegmentLayout,
    allocate_path,
    gather_nuisance,
    integrate_segments,
    push_wrenches,
    segment_in_all_lanes,
    shift_chain_time,
)
from bcid.likelihood.lane_start import begin_rollout, first_lags_of_one, steps_of_recording
from bcid.likelihood.observe import observe_means
from bcid.likelihood.take import KNOTS, N_START
from bcid.physics.car import Car
from bcid.physics.kinematics import wheel_velocity
from bcid.physics.tyres import lateral_force, slip_angle

ANGLE_STEP_RAD = 1e-4  # of differences by the steered angle
PUSH_STEP = 1e-2  # m/s^2, rad/s^2: largest acceleration of differences by a basis function


class BasisState(NamedTuple):
    """The car's state and forces at an instant, on which basis functions depend."""

    elapsed_share: float  # t / T
    body: BodyState
    delta: float  # rad, of the front wheel
    u_m: float  # throttle
    v_fx: float  # m/s along the front wheel
    F_m: float  # N, of the motor
    F_af: float  # N, side force of the front tyre
    F_ar: float  # N, of the rear tyres
    F_m_rate: float  # N/s
    F_af_rate: float  # N/s
    F_af_rounding: float  # N, of a side force that nears its limit smoothly less one that is clipped there
    F_ar_rounding: float  # N
    front_grips: float  # 1 while the front tyre does not slide, else 0
    in_circle: float  # 1 in the circle that stands out, else 0


@njit_inline
def _smooth_sign(v: float, v_c: float) -> float:
    """Smooth replacement of sign(v): tanh(v / v_c), with v and v_c in the same unit (m/s or rad/s)."""
    return math.tanh(v / v_c)


@njit_inline
def body_drag_basis(q: BasisState, c: Constants) -> tuple[float, ...]:
    """The four basis functions of a regression for a force along the body's x axis, evaluated at the state `q`.

    They are tanh(v_x / v_c), v_x, |V| v_x, and v_x inside the circle on the floor where disturbances are largest (0
    outside).  The regression multiplies each with an unknown coefficient.
    """
    v = math.hypot(q.body.v_x, q.body.v_y)
    return _smooth_sign(q.body.v_x, c.v_c), q.body.v_x, v * q.body.v_x, q.in_circle * q.body.v_x


@njit_inline
def front_wheel_drag_basis(q: BasisState, c: Constants) -> tuple[float, ...]:
    """The four basis functions of a regression for a force along the front wheel, evaluated at the state `q`.

    They are tanh(v_fx / v_c), v_fx, |delta| v_fx, and v_fx inside the circle on the floor where disturbances are
    largest (0 outside); v_fx is the hub's speed along the wheel.  The regression multiplies each with an unknown
    coefficient.
    """
    return _smooth_sign(q.v_fx, c.v_c), q.v_fx, abs(q.delta) * q.v_fx, q.in_circle * q.v_fx


@njit_inline
def floor_pull_basis(q: BasisState) -> tuple[float, ...]:
    """The three basis functions of a regression for a force along one world axis: 1, and the CoG's x and y (m).

    The regression multiplies each with an unknown coefficient: a uniform force, and gradients of it over the floor.
    """
    return 1.0, q.body.p_x, q.body.p_y


@njit_inline
def motor_force_basis(q: BasisState) -> tuple[float, ...]:
    """The seven basis functions of a regression for a force along the driven wheels, evaluated at the state `q`.

    They are the motor's force F_m, dF_m/dt, (t/T) F_m, |v_fx| F_m; [u_m > 0] and [u_m > 0] max(v_fx - u_m, 0), with
    throttle u_m and front wheel speed v_fx; and |F_m| F_m.  The regression multiplies each with an unknown coefficient.
    """
    pulling = 1.0 if q.u_m > 0.0 else 0.0
    return (
        q.F_m, q.F_m_rate, q.elapsed_share * q.F_m, abs(q.v_fx) * q.F_m, pulling, pulling * max(q.v_fx - q.u_m, 0.0),
        abs(q.F_m) * q.F_m,
    )  # fmt: skip


@njit_inline
def front_tyre_basis(q: BasisState, c: Constants) -> tuple[float, ...]:
    """The seven basis functions of a regression for a force across the front wheel, evaluated at the state `q`.

    They are the side force F_af, F_af F_m cos(delta), F_af F_m^2; tanh(v_fx / v_c), but 0 where F_af is at its limit;
    (dF_af/dt) / |v_fx|; F_af by a smooth (tanh) saturation less F_af by a clipped one; and F_af inside the circle on
    the floor where disturbances are largest.  The regression multiplies each with an unknown coefficient.
    """
    return (
        q.F_af, q.F_m * math.cos(q.delta) * q.F_af, q.F_m * q.F_m * q.F_af, q.front_grips * _smooth_sign(q.v_fx, c.v_c),
        q.F_af_rate / max(abs(q.v_fx), c.v_p), q.F_af_rounding, q.in_circle * q.F_af,
    )  # fmt: skip


@njit_inline
def rear_tyre_basis(q: BasisState, c: Constants) -> tuple[float, ...]:
    """The four basis functions of a regression for a force across the rear wheels, evaluated at the state `q`.

    They are the side force F_ar, tanh(v_x / v_c), F_ar by a smooth (tanh) saturation less F_ar by a clipped one, and
    F_ar inside the circle on the floor where disturbances are largest.  The regression gives each an unknown
    coefficient.
    """
    return q.F_ar, _smooth_sign(q.body.v_x, c.v_c), q.F_ar_rounding, q.in_circle * q.F_ar


@njit_inline
def yaw_moment_basis(q: BasisState, c: Constants) -> tuple[float, ...]:
    """The four basis functions of a regression for a yaw moment, evaluated at the state `q`.

    They are omega, tanh(omega / w_c), |omega| omega, and F_m cos(delta), with the motor's force F_m.  The regression
    multiplies each with an unknown coefficient.
    """
    w = q.body.omega
    return w, _smooth_sign(w, c.w_c), abs(w) * w, q.F_m * math.cos(q.delta)


@njit_inline
def steering_angle_basis(q: BasisState) -> tuple[float, ...]:
    """The two basis functions of a regression for an error of the front wheel's angle: |V| delta and F_af.

    V is the CoG's velocity, F_af (N) the front tyre's side force.  The regression gives each an unknown coefficient.
    """
    return math.hypot(q.body.v_x, q.body.v_y) * q.delta, q.F_af


@njit_inline
def _add_basis_columns(out: Floats, j: int, values: tuple[float, ...], direction: tuple[float, float, float]) -> int:
    """Add values[k] times the wrench `direction` (F_x, F_y, M_z) to column j + k of `out` (3, n), for every k.

    Returns j + len(values), the next free column.
    """
    for phi in values:
        for i in range(3):
            out[i, j] += phi * direction[i]
        j += 1
    return j


def _basis_size(function: Any, *more: Any) -> int:
    """Number of basis functions in a group, such as `yaw_moment_basis`, found by calling the uncompiled function once.

    `more` are the arguments that the function takes after the state.
    """
    nothing = BodyState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return len(function.py_func(BasisState(0.0, nothing, *[0.0] * 12), *more))


_C = Constants()
BASIS_SIZES = {
    "fx": _basis_size(body_drag_basis, _C)
    + _basis_size(front_wheel_drag_basis, _C)
    + 2 * _basis_size(floor_pull_basis),
    "motor": _basis_size(motor_force_basis),
    "fy": _basis_size(front_tyre_basis, _C) + _basis_size(rear_tyre_basis, _C),
    "mz": _basis_size(yaw_moment_basis, _C),
    "steering": _basis_size(steering_angle_basis),
}
"""Number of columns of each channel that pushes the body, in the order of `_add_basis_wrenches`."""


@njit_inline
def _add_basis_wrenches(
    out: Floats, q: BasisState, wrench_per_rad: tuple[float, float, float], p: Car, c: Constants
) -> None:
    """Add to each column of `out` (3, n) the wrench F_x, F_y, M_z (body) of one basis function with coefficient 1.

    The n basis functions are functions of the state `q` with which a regression describes missing physics.  Each acts
    in one direction: along or across a wheel, along the body or a world axis, about the yaw axis, or as a change of
    the front wheel's angle, for which `wrench_per_rad` is the derivative of the wrench by this angle.
    """
    sin_d, cos_d, sin_t, cos_t = math.sin(q.delta), math.cos(q.delta), math.sin(q.body.theta), math.cos(q.body.theta)
    front, rear = p.front_share, 1.0 - p.front_share
    j = _add_basis_columns(out, 0, body_drag_basis(q, c), (1.0, 0.0, 0.0))
    j = _add_basis_columns(out, j, front_wheel_drag_basis(q, c), (cos_d, sin_d, p.l_f * sin_d))
    j = _add_basis_columns(out, j, floor_pull_basis(q), (cos_t, -sin_t, 0.0))
    j = _add_basis_columns(out, j, floor_pull_basis(q), (sin_t, cos_t, 0.0))
    j = _add_basis_columns(out, j, motor_force_basis(q), (front * cos_d + rear, front * sin_d, front * p.l_f * sin_d))
    j = _add_basis_columns(out, j, front_tyre_basis(q, c), (-sin_d, cos_d, p.l_f * cos_d))
    j = _add_basis_columns(out, j, rear_tyre_basis(q, c), (0.0, 1.0, -p.l_r))
    j = _add_basis_columns(out, j, yaw_moment_basis(q, c), (0.0, 0.0, 1.0))
    _add_basis_columns(out, j, steering_angle_basis(q), wrench_per_rad)


@njit_inline
def _side_force_and_rounding(alpha: float, C: float, F: float) -> tuple[float, float]:
    """Side force (N) of a tyre at slip angle `alpha` (rad), and what a smooth saturation would add to it (N).

    The side force is F_a = clip(-C alpha, -F, F), with cornering stiffness `C` (N/rad) and limit `F` (N); the second
    value is F tanh(-C alpha / F) - F_a.
    """
    clipped = lateral_force(alpha, C, F)
    return clipped, tyre_soft_saturation(-C * alpha, F, 1.0) - clipped


@njit
def _segment_basis_wrenches(
    start: Floats, step: int, steps: int, chain: ActuatorChain, T: float, p: Car, e: Switches, c: Constants,
    circle: FloorCircle, n: int,
) -> Floats:  # fmt: skip
    """Wrenches F_x, F_y (N), M_z (N m) (body) of n basis functions in each step of a segment: (steps, 3, n).

    The basis functions are functions of the state with which a regression describes missing physics; each has
    coefficient 1.  They are evaluated along the predicted motion and averaged over both ends of each step.  The
    prediction begins at integration step `step` of a recording of `T` (s), with initial state and disturbances
    `start` (N_NUISANCE,).
    """
    out, ends = np.zeros((steps, 3, n)), np.zeros((2, 3, n))
    pushes, each = push_wrenches(start, p), steps // KNOTS
    b, F_m, F_af, h = unpack_body(start), 0.0, 0.0, chain.h
    lags = first_lags_of_one(b, step, steps_of_recording(step, chain), chain, T, p, e, c)
    path = integrate_body(b, lags, step, steps, chain, T, pushes, each, p, e, c)
    for i in range(steps + 1):
        b, lags = unpack_body(path[i]), unpack_lags(path[i])
        act, F_m_before, F_af_before = actuation_at(step + i, chain, T), F_m, F_af
        more = Actuation(
            act.t, T, act.delta + ANGLE_STEP_RAD, act.delta_rate, act.u_m, act.u_next, act.late, act.brake, act.rest
        )  # fmt: skip
        w, turned = wrench_with_effects(b, act, lags, p, e, c), wrench_with_effects(b, more, lags, p, e, c)
        dF_x, dF_y, dM_z = turned.F_x - w.F_x, turned.F_y - w.F_y, turned.M_z - w.M_z
        F_m = driving_force(w.steady, p)
        F_af, F_af_rounding = _side_force_and_rounding(w.steady.alpha_f, p.C_f, p.F_f_max)
        v_rx, v_ry = wheel_velocity(b.v_x, b.v_y, b.omega, -p.l_r, 0.0)
        F_ar, F_ar_rounding = _side_force_and_rounding(slip_angle(v_rx, v_ry, p.v_0), p.C_r, p.F_r_max)
        if i == 0:
            F_m_before, F_af_before = F_m, F_af
        near = (b.p_x - circle.x) ** 2 + (b.p_y - circle.y) ** 2 < circle.radius**2
        q = BasisState(
            act.t / T, b, act.delta, act.u_m, w.v_fx, F_m, F_af, F_ar, (F_m - F_m_before) / h, (F_af - F_af_before) / h,
            F_af_rounding, F_ar_rounding, 1.0 if abs(F_af) < p.F_f_max else 0.0, 1.0 if near else 0.0,
        )  # fmt: skip
        ends[0] = ends[1]
        ends[1] = 0.0
        wrench_per_rad = (dF_x / ANGLE_STEP_RAD, dF_y / ANGLE_STEP_RAD, dM_z / ANGLE_STEP_RAD)
        _add_basis_wrenches(ends[1], q, wrench_per_rad, p, c)
        if i > 0:
            out[i - 1] = 0.5 * (ends[0] + ends[1])
    return out


@njit_parallel
def wrench_basis_changes(
    layout: SegmentLayout, start: Floats, chain: ActuatorChain, p: Car, e: Switches, c: Constants, circle: FloorCircle,
    n: int,
) -> Floats:  # fmt: skip
    """Derivatives (N, 3, n) of the predicted poses by the coefficients of `n` basis functions, by finite differences.

    Basis functions are functions of the state, such as v_x or omega, that act as forces or moments on the body; some
    act only inside `circle`.  Predictions start from `start` (S, N_NUISANCE), each segment's initial state and
    disturbances; `e` is an array with one record of effect parameters.
    """
    out, inertia = np.zeros((layout.first[-1], 3, n)), np.array([p.m, p.m, p.I_z])
    for s in numba.prange(len(layout.step)):
        f, g, mine = layout.first[s], layout.first[s + 1], segment_in_all_lanes(s, layout, chain)
        free, path = gather_nuisance(start, mine), allocate_path(layout.steps)
        pushes = np.empty((layout.steps, 3, LANES))
        knots, begin = push_wrenches(free, p), begin_rollout(free[:N_START], mine, chain, p, e[0], c)
        for i in range(layout.steps):
            pushes[i] = knots[i // (layout.steps // KNOTS)]
        seen, place = np.zeros((LANES * (g - f), 3, 1)), (g - f) * np.arange(LANES)
        integrate_segments(path, begin, layout.steps, pushes, mine, chain, p, e[0], c)
        observe_means(seen, place, 0, path, 1, mine, layout, chain.h)
        still = seen[: g - f, :, 0].copy()
        own = shift_chain_time(chain, layout.zero_s[s])
        wrenches = _segment_basis_wrenches(
            start[s], layout.step[s], layout.steps, own, layout.length_s[s], p, e[0], c, circle, n
        )
        strongest = np.array([np.max(np.abs(wrenches[:, :, j] / inertia)) for j in range(n)])
        acting = np.flatnonzero(strongest)
        for first in range(0, len(acting), LANES):
            columns, moved = acting[first : first + LANES], pushes.copy()
            for k, j in enumerate(columns):
                moved[:, :, k] += PUSH_STEP / strongest[j] * wrenches[:, :, j]
            integrate_segments(path, begin, layout.steps, moved, mine, chain, p, e[0], c)
            observe_means(seen, place, 0, path, LANES, mine, layout, chain.h)
            for k, j in enumerate(columns):
                change = seen[k * (g - f) : (k + 1) * (g - f), :, 0] - still
                out[f:g, :2, j] = change[:, :2] * (1.0 + e[0].pose_scale__kappa) * (strongest[j] / PUSH_STEP)
                out[f:g, 2, j] = change[:, 2] * (strongest[j] / PUSH_STEP)
    return out

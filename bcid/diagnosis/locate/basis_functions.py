"""Plain functions of the state that may act on the body, at every place where physics may be missing.

Each comes with its direction: along or across a wheel, along the body, over the floor, about the yaw axis, or as
a turn of the steered wheel.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from bcid.aliases import Floats
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline, njit_parallel
from bcid.diagnosis.locate.scan_statistic import Circle
from bcid.effects.car import Body, Drive, wrench
from bcid.effects.constants import Constants
from bcid.effects.motion import Chain, body_step, settled
from bcid.effects.tyres import side_force
from bcid.likelihood.lane_rollout import Layout, begun, driven, new_path, see, segment_alone, since
from bcid.likelihood.predict import PUSH, free_of, pushes_of
from bcid.likelihood.take import KNOTS, N_START
from bcid.physics.car import Car
from bcid.physics.kinematics import wheel_velocity
from bcid.physics.tyres import lateral_force, slip_angle

NUDGE = 1e-4  # rad


class State(NamedTuple):
    """What the functions may depend on, at an instant."""

    share: float  # of the take that has passed
    b: Body
    delta: float
    u_m: float
    v_fx: float
    F_m: float
    F_af: float
    F_ar: float
    rate_m: float  # of F_m, N/s
    rate_af: float  # N/s
    less_f: float  # N of front side force that a smooth curve near the grip does not reach
    less_r: float
    grips: float  # 1 while the front tyre does not slide, else 0
    inside: float  # 1 in the circle that stands out, else 0


@njit_inline
def _coulomb(v: float, v_c: float) -> float:
    return math.tanh(v / v_c)


@njit_inline
def along_the_body(q: State, c: Constants) -> tuple[float, ...]:
    """Drags of the rear axle and the air, N per unit."""
    v = math.hypot(q.b.v_x, q.b.v_y)
    return _coulomb(q.b.v_x, c.v_c), q.b.v_x, v * q.b.v_x, q.inside * q.b.v_x


@njit_inline
def along_the_wheel(q: State, c: Constants) -> tuple[float, ...]:
    """Drags of the front wheel."""
    return _coulomb(q.v_fx, c.v_c), q.v_fx, abs(q.delta) * q.v_fx, q.inside * q.v_fx


@njit_inline
def over_the_floor(q: State) -> tuple[float, ...]:
    """Pulls in the world's directions: constant, and growing with the place."""
    return 1.0, q.b.p_x, q.b.p_y


@njit_inline
def of_the_motor(q: State) -> tuple[float, ...]:
    """Of the force along driven wheels."""
    pulling = 1.0 if q.u_m > 0.0 else 0.0
    return (
        q.F_m, q.rate_m, q.share * q.F_m, abs(q.v_fx) * q.F_m, pulling, pulling * max(q.v_fx - q.u_m, 0.0),
        abs(q.F_m) * q.F_m,
    )  # fmt: skip


@njit_inline
def of_the_front_tyre(q: State, c: Constants) -> tuple[float, ...]:
    """Of its side force; what shifts its slip does nothing once it slides."""
    return (
        q.F_af, q.F_m * math.cos(q.delta) * q.F_af, q.F_m * q.F_m * q.F_af, q.grips * _coulomb(q.v_fx, c.v_c),
        q.rate_af / max(abs(q.v_fx), c.v_p), q.less_f, q.inside * q.F_af,
    )  # fmt: skip


@njit_inline
def of_the_rear_tyres(q: State, c: Constants) -> tuple[float, ...]:
    """Of their side force."""
    return q.F_ar, _coulomb(q.b.v_x, c.v_c), q.less_r, q.inside * q.F_ar


@njit_inline
def about_the_yaw_axis(q: State, c: Constants) -> tuple[float, ...]:
    """Moments."""
    w = q.b.omega
    return w, _coulomb(w, c.w_c), abs(w) * w, q.F_m * math.cos(q.delta)


@njit_inline
def of_the_steering(q: State) -> tuple[float, ...]:
    """Of the wheel's angle, as far as it depends on how the car moves."""
    return math.hypot(q.b.v_x, q.b.v_y) * q.delta, q.F_af


@njit_inline
def _add(out: Floats, j: int, phi: float, F_x: float, F_y: float, M_z: float) -> int:
    """Column `j` of `out` (3, n) takes phi in the direction given; the next column."""
    out[0, j] += phi * F_x
    out[1, j] += phi * F_y
    out[2, j] += phi * M_z
    return j + 1


def _size(function: Any, *more: Any) -> int:
    nothing = Body(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return len(function.py_func(State(0.0, nothing, *[0.0] * 12), *more))


_C = Constants()
SIZES = {
    "fx": _size(along_the_body, _C) + _size(along_the_wheel, _C) + 2 * _size(over_the_floor),
    "motor": _size(of_the_motor),
    "fy": _size(of_the_front_tyre, _C) + _size(of_the_rear_tyres, _C),
    "mz": _size(about_the_yaw_axis, _C),
    "steering": _size(of_the_steering),
}
"""Columns of each channel that pushes the body, in the order of `_spread`."""


@njit_inline
def _spread(out: Floats, q: State, turning: tuple[float, float, float], p: Car, c: Constants) -> None:
    """Every function in its direction, added to the columns of `out` (3, n)."""
    sin_d, cos_d, sin_t, cos_t = math.sin(q.delta), math.cos(q.delta), math.sin(q.b.theta), math.cos(q.b.theta)
    rear, j = 1.0 - p.front_share, 0
    for phi in along_the_body(q, c):
        j = _add(out, j, phi, 1.0, 0.0, 0.0)
    for phi in along_the_wheel(q, c):
        j = _add(out, j, phi, cos_d, sin_d, p.l_f * sin_d)
    for phi in over_the_floor(q):
        j = _add(out, j, phi, cos_t, -sin_t, 0.0)
    for phi in over_the_floor(q):
        j = _add(out, j, phi, sin_t, cos_t, 0.0)
    for phi in of_the_motor(q):
        j = _add(out, j, phi, p.front_share * cos_d + rear, p.front_share * sin_d, p.front_share * p.l_f * sin_d)
    for phi in of_the_front_tyre(q, c):
        j = _add(out, j, phi, -sin_d, cos_d, p.l_f * cos_d)
    for phi in of_the_rear_tyres(q, c):
        j = _add(out, j, phi, 0.0, 1.0, -p.l_r)
    for phi in about_the_yaw_axis(q, c):
        j = _add(out, j, phi, 0.0, 0.0, 1.0)
    for phi in of_the_steering(q):
        j = _add(out, j, phi, turning[0], turning[1], turning[2])


@njit_inline
def _side(alpha: float, C: float, F: float) -> tuple[float, float]:
    """A tyre's side force, and how much less of it a smooth curve gives."""
    clipped = lateral_force(alpha, C, F)
    return clipped, side_force(alpha, C, F, 0.0, 1.0) - clipped


@njit
def _segment_wrenches(
    start: Floats, step: int, steps: int, chain: Chain, T: float, p: Car, e: Any, c: Constants, circle: Circle, n: int
) -> Floats:
    """The functions' wrenches in every step (steps, 3, n), the means of those at its ends."""
    out, at = np.zeros((steps, 3, n)), np.zeros((2, 3, n))
    pushes, each = pushes_of(start, p), steps // KNOTS
    b = Body(start[0], start[1], start[2], start[3], start[4], start[5])
    lagged, F_m, F_af, h = settled(b, step, chain, T, p, e, c), 0.0, 0.0, chain.h
    for i in range(steps + 1):
        k = step + i
        t, delta, F_m_before, F_af_before = chain.t_0 + k * h, chain.delta[2 * k], F_m, F_af
        w = wrench(b, Drive(t, T, delta, chain.u_m[k], chain.u_next[k], chain.late[k]), lagged, p, e, c)
        more = wrench(b, Drive(t, T, delta + NUDGE, chain.u_m[k], chain.u_next[k], chain.late[k]), lagged, p, e, c)
        turning = ((more.F_x - w.F_x) / NUDGE, (more.F_y - w.F_y) / NUDGE, (more.M_z - w.M_z) / NUDGE)
        F_m = p.front_share * w.steady.F_mf + (1.0 - p.front_share) * w.steady.F_mr
        F_af, less_f = _side(w.steady.alpha_f, p.C_f, p.F_f_max)
        v_rx, v_ry = wheel_velocity(b.v_x, b.v_y, b.omega, -p.l_r, 0.0)
        F_ar, less_r = _side(slip_angle(v_rx, v_ry, p.v_0), p.C_r, p.F_r_max)
        if i == 0:
            F_m_before, F_af_before = F_m, F_af
        near = (b.p_x - circle.x) ** 2 + (b.p_y - circle.y) ** 2 < circle.radius**2
        q = State(
            t / T, b, delta, chain.u_m[k], w.v_fx, F_m, F_af, F_ar, (F_m - F_m_before) / h, (F_af - F_af_before) / h,
            less_f, less_r, 1.0 if abs(F_af) < p.F_f_max else 0.0, 1.0 if near else 0.0,
        )  # fmt: skip
        at[0] = at[1]
        at[1] = 0.0
        _spread(at[1], q, turning, p, c)
        if i > 0:
            out[i - 1] = 0.5 * (at[0] + at[1])
        if i < steps:
            b, lagged = body_step(b, lagged, k, chain, T, pushes[i // each], p, e, c)
    return out


@njit_parallel
def pushed_by(of: Layout, start: Floats, chain: Chain, p: Car, e: Any, c: Constants, circle: Circle, n: int) -> Floats:
    """What the functions' wrenches change in the predicted poses (N, 3, n), per unit."""
    out, inertia = np.zeros((of.first[-1], 3, n)), np.array([p.m, p.m, p.I_z])
    for s in numba.prange(len(of.step)):
        f, g, mine = of.first[s], of.first[s + 1], segment_alone(s, of, chain)
        free, path, pushes = free_of(start, mine), new_path(of.steps), np.empty((of.steps, 3, LANES))
        knots, begin = pushes_of(free, p), begun(free[:N_START], mine, chain, p, e[0], c)
        for i in range(of.steps):
            pushes[i] = knots[i // (of.steps // KNOTS)]
        still = np.zeros((g - f, 3))
        driven(path, begin, of.steps, pushes, mine, chain, p, e[0], c)
        see(still, path, 0, 0, mine, of, chain.h, e[0])
        own = since(chain, of.zero[s])
        wrenches = _segment_wrenches(start[s], of.step[s], of.steps, own, of.length[s], p, e[0], c, circle, n)
        strongest = np.array([np.max(np.abs(wrenches[:, :, j] / inertia)) for j in range(n)])
        acting = np.flatnonzero(strongest)
        for first in range(0, len(acting), LANES):
            columns, moved = acting[first : first + LANES], pushes.copy()
            for k, j in enumerate(columns):
                moved[:, :, k] += PUSH / strongest[j] * wrenches[:, :, j]
            driven(path, begin, of.steps, moved, mine, chain, p, e[0], c)
            for k, j in enumerate(columns):
                seen = np.zeros((g - f, 3))
                see(seen, path, k, 0, mine, of, chain.h, e[0])
                out[f:g, :, j] = (seen - still) * (strongest[j] / PUSH)
    return out

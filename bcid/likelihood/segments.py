"""Predicted poses of all segments, and how they answer to initial states and to pushes on the body."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from bcid.compiled import njit, njit_parallel
from bcid.effects.car import Body, Lagged, alike_everywhere
from bcid.effects.constants import Constants
from bcid.effects.measurement import seen_pose
from bcid.effects.motion import Chain, body_step, settled
from bcid.likelihood.take import KNOTS, N_FREE, N_START, Floats, Ints, Take
from bcid.physics.car import Car

NUDGE = 1e-3  # of the initial state (m, rad, m/s, rad/s): wide enough that a kink met or missed does not rule
N_POSE = 3  # of the initial state, in the world
PUSH = 1e-2  # of the pushes (m/s^2, rad/s^2)


@njit
def _hermite(a: float, b: float, rate_a: float, rate_b: float, u: float, h: float) -> float:
    """Cubic between a and b with their rates, at the share u of the step h."""
    return (
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * a + u * (1.0 - u) ** 2 * h * rate_a
        + u * u * (3.0 - 2.0 * u) * b - u * u * (1.0 - u) * h * rate_b
    )  # fmt: skip


class Way(NamedTuple):
    """Where the prediction of a segment has come to."""

    b: Body
    lagged: Lagged
    i: int  # steps done
    j: int  # stamps passed


@njit
def begun(x: Floats, step: int, chain: Chain, T: float, p: Car, e: Any, c: Constants) -> Way:
    """The beginning of a segment in the state `x` (6,), its lags settled."""
    b = Body(x[0], x[1], x[2], x[3], x[4], x[5])
    return Way(b, settled(b, step, chain, T, p, e, c), 0, 0)


@njit
def poses_on(
    out: Floats,
    stamps: Floats,
    row: Ints,
    share: Floats,
    way: Way,
    until: int,
    pushes: Floats,
    step: int,
    steps: int,
    chain: Chain,
    T: float,
    p: Car,
    e: Any,
    c: Constants,
) -> Way:
    """Add the poses seen at those `stamps` that come before the step `until`, each with its share, to their rows.

    Under `pushes` (n, 3), wrenches, each for an nth of all `steps` of the segment.
    """
    b, lagged, j, h = way.b, way.lagged, way.j, chain.h
    each = steps // len(pushes)
    for i in range(way.i, until):
        after, lagged = body_step(b, lagged, step + i, chain, T, pushes[i // each], p, e, c)
        end = chain.t_0 + (step + i + 1) * h
        if j < len(stamps) and (stamps[j] <= end or i == steps - 1):
            cos_a, sin_a = math.cos(b.theta), math.sin(b.theta)
            cos_b, sin_b = math.cos(after.theta), math.sin(after.theta)
            x_a, y_a = cos_a * b.v_x - sin_a * b.v_y, sin_a * b.v_x + cos_a * b.v_y
            x_b, y_b = cos_b * after.v_x - sin_b * after.v_y, sin_b * after.v_x + cos_b * after.v_y
            while j < len(stamps) and (stamps[j] <= end or i == steps - 1):
                u = 1.0 - (end - stamps[j]) / h
                seen = seen_pose(
                    _hermite(b.p_x, after.p_x, x_a, x_b, u, h), _hermite(b.p_y, after.p_y, y_a, y_b, u, h),
                    _hermite(b.theta, after.theta, b.omega, after.omega, u, h), e.marker_offset__d_x,
                    e.marker_offset__d_y, e.body_yaw_misalignment__psi, e.pose_scale__kappa,
                )  # fmt: skip
                out[row[j], 0] += share[j] * seen[0]
                out[row[j], 1] += share[j] * seen[1]
                out[row[j], 2] += share[j] * seen[2]
                j += 1
        b = after
    return Way(b, lagged, until, j)


@njit
def segment_poses(
    out: Floats,
    stamps: Floats,
    row: Ints,
    share: Floats,
    x: Floats,
    pushes: Floats,
    step: int,
    steps: int,
    chain: Chain,
    T: float,
    p: Car,
    e: Any,
    c: Constants,
) -> None:
    """`poses_on` for a whole segment from the state `x` (6,)."""
    way = begun(x, step, chain, T, p, e, c)
    poses_on(out, stamps, row, share, way, steps, pushes, step, steps, chain, T, p, e, c)


class Layout(NamedTuple):
    """Where the segments' stamps and rows are: the part of a `Take` that predictions need."""

    stamps: Floats
    row: Ints
    share: Floats
    first_stamp: Ints
    first: Ints
    step: Ints
    steps: int
    zero: Floats
    length: Floats


def layout(take: Take) -> Layout:
    """The layout of `take`."""
    return Layout(
        take.stamp_s, take.row, take.share, take.first_stamp, take.first, take.step, take.steps, take.zero_s,
        take.length_s,
    )  # fmt: skip


@njit
def since(chain: Chain, zero: float) -> Chain:
    """The chain with its time counted from `zero`, where a recording began."""
    return Chain(chain.t_0 - zero, chain.h, chain.delta, chain.u_m, chain.u_next, chain.late)


@njit
def pushes_of(start: Floats, p: Car) -> Floats:
    """The wrenches (KNOTS, 3) in a free part `start` (N_FREE,), which holds them as accelerations."""
    wrench = start[N_START:].copy().reshape((KNOTS, 3))
    wrench[:, :2] *= p.m
    wrench[:, 2] *= p.I_z
    return wrench


@njit_parallel
def predict(of: Layout, start: Floats, chain: Chain, p: Car, e: Any, c: Constants) -> Floats:
    """Mean poses (N, 3) of all rows from the segments' initial states and under their pushes, `start` (S, N_FREE).

    Here as in `free_sensitivities`, `e` is an array of one record: a parallel loop cannot be handed the record.
    """
    out = np.zeros((of.first[-1], 3))
    for s in numba.prange(len(of.step)):
        a, b, pushes = of.first_stamp[s], of.first_stamp[s + 1], pushes_of(start[s], p)
        segment_poses(
            out, of.stamps[a:b] - of.zero[s], of.row[a:b], of.share[a:b], start[s], pushes, of.step[s], of.steps,
            since(chain, of.zero[s]), of.length[s], p, e[0], c,
        )  # fmt: skip
    return out


@njit_parallel
def free_sensitivities(of: Layout, start: Floats, chain: Chain, p: Car, e: Any, c: Constants) -> Floats:
    """D pose / d `start`, (N, 3, N_FREE), by differences; of a car that drives alike everywhere, it moves as one."""
    out, rigid = np.zeros((of.first[-1], 3, N_FREE)), alike_everywhere(e[0])
    for s in numba.prange(len(of.step)):
        a, b, f, g = of.first_stamp[s], of.first_stamp[s + 1], of.first[s], of.first[s + 1]
        stamps, row, share = of.stamps[a:b] - of.zero[s], of.row[a:b] - f, of.share[a:b]
        own, T, step, each = since(chain, of.zero[s]), of.length[s], of.step[s], of.steps // KNOTS
        still, pushes = np.zeros((g - f, 3)), pushes_of(start[s], p)
        for j in range(N_POSE if rigid else 0, N_START):
            x = start[s].copy()
            x[j] += NUDGE
            moved = np.zeros((g - f, 3))
            segment_poses(moved, stamps, row, share, x, pushes, step, of.steps, own, T, p, e[0], c)
            out[f:g, :, j] = moved
        way = begun(start[s], step, own, T, p, e[0], c)
        for k in range(KNOTS):  # a push changes nothing before it begins
            for j in range(N_START + 3 * k, N_START + 3 * (k + 1)):
                x = start[s].copy()
                x[j] += PUSH
                moved = still.copy()
                poses_on(moved, stamps, row, share, way, of.steps, pushes_of(x, p), step, of.steps, own, T, p, e[0], c)
                out[f:g, :, j] = moved
            way = poses_on(still, stamps, row, share, way, (k + 1) * each, pushes, step, of.steps, own, T, p, e[0], c)
        for j in range(N_POSE if rigid else 0, N_FREE):
            out[f:g, :, j] = (out[f:g, :, j] - still) / (NUDGE if j < N_START else PUSH)
        if rigid:
            scale = 1.0 + e[0].pose_scale__kappa
            out[f:g, 0, 0] = scale
            out[f:g, 1, 1] = scale
            out[f:g, 0, 2] = scale * start[s, 1] - still[:, 1]
            out[f:g, 1, 2] = still[:, 0] - scale * start[s, 0]
            out[f:g, 2, 2] = 1.0
    return out


def half_steps(T: float, h: float) -> int:
    """Integration steps of `h` seconds that cover a recording of `T` seconds."""
    return math.ceil(T / h) + 2


def wrapped(residual: Floats) -> Floats:
    """The residual (N, 3) with its yaw in (-pi, pi]."""
    residual = residual.copy()
    residual[:, 2] -= 2.0 * np.pi * np.round(residual[:, 2] / (2.0 * np.pi))
    return residual

"""Predicted poses of all segments, and how they answer to initial states and to pushes on the body."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from bcid.compiled import njit, njit_parallel
from bcid.effects.car import Body
from bcid.effects.constants import Constants
from bcid.effects.measurement import seen_pose
from bcid.effects.motion import Chain, body_step, settled
from bcid.likelihood.take import KNOTS, N_FREE, N_START, Floats, Ints, Take
from bcid.physics.car import Car

NUDGE = 1e-3  # of the initial state (m, rad, m/s, rad/s): wide enough that a kink met or missed does not rule
PUSH = 1e-2  # of the pushes (m/s^2, rad/s^2)


@njit
def _hermite(a: float, b: float, rate_a: float, rate_b: float, u: float, h: float) -> float:
    """Cubic between a and b with their rates, at the share u of the step h."""
    return (
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * a + u * (1.0 - u) ** 2 * h * rate_a
        + u * u * (3.0 - 2.0 * u) * b - u * u * (1.0 - u) * h * rate_b
    )  # fmt: skip


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
    """Add the poses seen at `stamps`, each with its share, to their rows of `out`.

    The state begins at `x` (6,) and is under `pushes` (n, 3), wrenches, each for an nth of the time.
    """
    b = Body(x[0], x[1], x[2], x[3], x[4], x[5])
    lagged = settled(b, step, chain, T, p, e, c)
    j = 0
    h = chain.h
    each = steps // len(pushes)
    for i in range(steps):
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
    """D pose / d `start`, (N, 3, N_FREE), by differences."""
    out = np.empty((of.first[-1], 3, N_FREE))
    for s in numba.prange(len(of.step)):
        a, b, f, g = of.first_stamp[s], of.first_stamp[s + 1], of.first[s], of.first[s + 1]
        stamps, row, share = of.stamps[a:b] - of.zero[s], of.row[a:b] - f, of.share[a:b]
        own, T = since(chain, of.zero[s]), of.length[s]
        still = np.zeros((g - f, 3))
        segment_poses(
            still, stamps, row, share, start[s], pushes_of(start[s], p), of.step[s], of.steps, own, T, p, e[0], c
        )
        for j in range(N_FREE):
            x, width = start[s].copy(), NUDGE if j < N_START else PUSH
            x[j] += width
            moved = np.zeros((g - f, 3))
            segment_poses(moved, stamps, row, share, x, pushes_of(x, p), of.step[s], of.steps, own, T, p, e[0], c)
            for i in range(g - f):
                for r in range(3):
                    out[f + i, r, j] = (moved[i, r] - still[i, r]) / width
    return out


def half_steps(T: float, h: float) -> int:
    """Integration steps of `h` seconds that cover a recording of `T` seconds."""
    return math.ceil(T / h) + 2


def wrapped(residual: Floats) -> Floats:
    """The residual (N, 3) with its yaw in (-pi, pi]."""
    residual = residual.copy()
    residual[:, 2] -= 2.0 * np.pi * np.round(residual[:, 2] / (2.0 * np.pi))
    return residual

"""Predicted poses of all segments, and how they answer to initial states and to pushes on the body."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from bcid.compiled import njit, njit_parallel
from bcid.diagnosis.take import STEP_S, Floats, Ints
from bcid.effects.car import Body
from bcid.effects.constants import Constants
from bcid.effects.measurement import seen_pose
from bcid.effects.motion import Chain, body_step, settled
from bcid.physics.car import Car

KNOT_S = 0.5  # a push is constant over this long
KNOTS = 3
N_FREE = 6 + 3 * KNOTS  # initial state, then F_x, F_y, M_z of each knot
NUDGE = np.array([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])  # of the initial state, m, rad, m/s, rad/s
PUSH = 1e-3  # of the wrench, as an acceleration (m/s^2, rad/s^2)


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
    """Write the poses seen at `stamps` into `out` (n, 3), from the state `x` (6,) under `pushes` (KNOTS, 3)."""
    b = Body(x[0], x[1], x[2], x[3], x[4], x[5])
    lagged = settled(b, step, chain, T, p, e, c)
    j = 0
    per_knot = round(KNOT_S / chain.h)
    for i in range(steps):
        knot = min(i // per_knot, KNOTS - 1)
        after, lagged = body_step(b, lagged, step + i, chain, T, pushes[knot], p, e, c)
        end = chain.t_0 + (step + i + 1) * chain.h
        while j < len(stamps) and (stamps[j] <= end or i == steps - 1):
            u = 1.0 - (end - stamps[j]) / chain.h
            cos_a, sin_a = math.cos(b.theta), math.sin(b.theta)
            cos_b, sin_b = math.cos(after.theta), math.sin(after.theta)
            p_x = _hermite(
                b.p_x, after.p_x, cos_a * b.v_x - sin_a * b.v_y, cos_b * after.v_x - sin_b * after.v_y, u, chain.h
            )  # fmt: skip
            p_y = _hermite(
                b.p_y, after.p_y, sin_a * b.v_x + cos_a * b.v_y, sin_b * after.v_x + cos_b * after.v_y, u, chain.h
            )  # fmt: skip
            theta = _hermite(b.theta, after.theta, b.omega, after.omega, u, chain.h)
            out[j, 0], out[j, 1], out[j, 2] = seen_pose(
                p_x, p_y, theta, e.marker_offset__d_x, e.marker_offset__d_y, e.body_yaw_misalignment__psi,
                e.pose_scale__kappa,
            )  # fmt: skip
            j += 1
        b = after


@njit_parallel
def predict(
    stamps: Floats,
    first: Ints,
    step: Ints,
    steps: int,
    start: Floats,
    chain: Chain,
    T: float,
    p: Car,
    e: Any,
    c: Constants,
) -> Floats:
    """Poses (N, 3) of all segments from their initial states `start` (S, 6), without pushes."""
    out = np.empty((len(stamps), 3))
    still = np.zeros((KNOTS, 3))
    for s in numba.prange(len(step)):
        a, b = first[s], first[s + 1]
        segment_poses(out[a:b], stamps[a:b], start[s], still, step[s], steps, chain, T, p, e, c)
    return out


@njit_parallel
def free_sensitivities(
    stamps: Floats,
    first: Ints,
    step: Ints,
    steps: int,
    start: Floats,
    chain: Chain,
    T: float,
    p: Car,
    e: Any,
    c: Constants,
) -> Floats:
    """D pose / d [initial state, pushes as accelerations], (N, 3, N_FREE), by central differences."""
    out = np.empty((len(stamps), 3, N_FREE))
    for s in numba.prange(len(step)):
        a, b = first[s], first[s + 1]
        ahead, behind = np.empty((b - a, 3)), np.empty((b - a, 3))
        for j in range(N_FREE):
            x, y = start[s].copy(), start[s].copy()
            push, pull = np.zeros((KNOTS, 3)), np.zeros((KNOTS, 3))
            if j < 6:
                width = NUDGE[j]
                x[j] += width
                y[j] -= width
            else:
                width = PUSH
                inertia = p.I_z if (j - 6) % 3 == 2 else p.m
                push[(j - 6) // 3, (j - 6) % 3] = width * inertia
                pull[(j - 6) // 3, (j - 6) % 3] = -width * inertia
            segment_poses(ahead, stamps[a:b], x, push, step[s], steps, chain, T, p, e, c)
            segment_poses(behind, stamps[a:b], y, pull, step[s], steps, chain, T, p, e, c)
            for i in range(b - a):
                for r in range(3):
                    out[a + i, r, j] = (ahead[i, r] - behind[i, r]) / (2.0 * width)
    return out


def half_steps(T: float) -> int:
    """Integration steps that cover a recording of `T` seconds."""
    return math.ceil(T / STEP_S) + 2


def wrapped(residual: Floats) -> Floats:
    """The residual (N, 3) with its yaw in (-pi, pi]."""
    residual = residual.copy()
    residual[:, 2] = np.angle(np.exp(1j * residual[:, 2]))
    return residual

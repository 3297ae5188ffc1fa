"""The compiled loops of the filter that `bcid.adaptation.filter` describes and prepares: poses enter one by one."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcid.adaptation.filter import CompiledFilter, forget
from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.export.tape import run_tape
from bcid.physics.kinematics import wrap_angle

OUTLIER = 4.0
"""Standard deviations from which on an innovation is taken for a wrong pose: one in 16,000 by chance."""
JUMP_POSES = 5
"""Poses in a row, each taken for wrong, after which the car is where they say: at 20 a second, a quarter of a second.
After one the place is so uncertain that a second moves the car by this part of the way there, and no quantity."""
BOUND_ROUNDS = 3
"""Times that quantities beyond their bounds are set back together: each may take others along."""


class FilterRun(NamedTuple):
    """What a run of the filter over M poses gives."""

    z: Floats  # (M, N) after each pose
    variance: Floats  # (M, N)
    innovation: Floats  # (M, 3) NaN where no pose was measured
    log_likelihood: float


@njit
def run_filter(
    f: CompiledFilter, z: Floats, P: Floats, commands: Floats, poses: Floats, settling: int = 0
) -> FilterRun:
    """Run the filter over M periods: `commands` (M, 2), each held for a period, and `poses` (M, 3) at the end of each.

    `z` (N,) and `P` (N, N) are state and covariance before the first, and after the last on return.  A pose that is NaN
    is passed over.  From the first `settling` poses nothing is learnt of the quantities.
    """
    M, N, n = len(commands), len(z), len(f.F)
    states, variances, innovations = np.empty((M, N)), np.empty((M, N)), np.full((M, 3), np.nan)
    inputs, x, h = np.empty(N + 2), np.empty(n + len(f.F_places)), np.empty(3 + len(f.H_places))
    step_places, pose_places = f.step.start.copy(), f.pose.start.copy()
    F, H, FP, PH = f.F.copy(), f.H.copy(), np.empty((N, N)), np.empty(N)
    total = 0.0
    for k in range(M):
        inputs[:N], inputs[N:] = z, commands[k]
        run_tape(f.step, inputs, step_places, x)
        for i in range(len(f.F_places)):
            F[f.F_places[i, 0], f.F_places[i, 1]] = x[n + i]
        forget(P, f.P_0, f.forgotten)
        predict_covariance(F, P, FP, f.Q)
        z[:n] = x[:n]
        if not math.isnan(poses[k, 0] + poses[k, 1] + poses[k, 2]):
            total += update(f, z, P, poses[k], inputs, pose_places, h, H, PH, innovations[k], settling <= 0)
            settling -= 1
        for i in range(N):
            states[k, i], variances[k, i] = z[i], P[i, i]
    return FilterRun(states, variances, innovations, total)


@njit
def predict_covariance(F: Floats, P: Floats, FP: Floats, Q: Floats) -> None:
    """P becomes F P F' + diag(Q), where below the n rows of F stand those of the unit matrix; `FP` is worked on."""
    n, N = F.shape
    for i in range(N):
        for j in range(N):
            FP[i, j] = 0.0 if i < n else P[i, j]
        if i < n:
            for m in range(N):
                slope = F[i, m]
                if slope != 0.0:
                    for j in range(N):
                        FP[i, j] += slope * P[m, j]
    for i in range(N):
        for j in range(i, N):
            if j < n:
                total = 0.0
                for m in range(N):
                    total += FP[i, m] * F[j, m]
            else:
                total = FP[i, j]
            P[i, j], P[j, i] = total, total
        P[i, i] += Q[i]


@njit
def update(
    f: CompiledFilter, z: Floats, P: Floats, pose: Floats, inputs: Floats, places: Floats, h: Floats, H: Floats,
    PH: Floats, innovation: Floats, settled: bool,
) -> float:  # fmt: skip
    """Let a measured `pose` (3,) enter z and P; returns its log-likelihood.

    Quantities learn if the state has `settled`, and the car moves.  What is between `pose` and that is worked on.
    """
    N, n, total = len(z), len(f.F), 0.0
    learns = settled and moves(f, z)
    for c in range(3):
        # anew for each number, as the one before has moved the state
        inputs[:N] = z
        run_tape(f.pose, inputs, places, h)
        for i in range(len(f.H_places)):
            H[f.H_places[i, 0], f.H_places[i, 1]] = h[3 + i]
        e = pose[c] - h[c]
        if c == 2:
            e = wrap_angle(e)
        s = f.r2[c]
        for i in range(N):
            PH[i] = 0.0
            for j in range(N):
                PH[i] += P[i, j] * H[c, j]
        for i in range(N):
            s += H[c, i] * PH[i]
        at_most = e * e / (OUTLIER * OUTLIER)
        doubt = at_most / JUMP_POSES if at_most > s else 0.0
        s = max(s, at_most)
        for i in range(N):
            if i < n or learns:
                z[i] += PH[i] * e / s
            for j in range(N):
                if i < n or j < n or learns:
                    P[i, j] -= PH[i] * PH[j] / s
        P[f.place[c], f.place[c]] += doubt
        innovation[c] = e
        total -= 0.5 * (math.log(2.0 * math.pi * s) + e * e / s)
    keep_within(f, z, P)
    return total


@njit
def moves(f: CompiledFilter, z: Floats) -> bool:
    """Whether the car moves, by its state."""
    v_x, v_y, yaw_rate = z[f.twist[0]], z[f.twist[1]], z[f.twist[2]]
    turning = f.wheelbase_m * yaw_rate
    return bool(v_x * v_x + v_y * v_y + turning * turning > f.least_mps * f.least_mps)


@njit
def keep_within(f: CompiledFilter, z: Floats, P: Floats) -> None:
    """Set quantities that have left their bounds to these, and let all of z go with them by the covariance.

    One that another has taken along beyond its own bound is set back in the next round, and in the end by itself.
    """
    n = len(f.F)
    for _ in range(BOUND_ROUNDS):
        for i in range(n, len(z)):
            bound = min(max(z[i], f.low[i - n]), f.high[i - n])
            off = bound - z[i]
            if off != 0.0 and P[i, i] > 0.0:
                for j in range(len(z)):
                    z[j] += P[j, i] * off / P[i, i]
                z[i] = bound
    for i in range(n, len(z)):
        z[i] = min(max(z[i], f.low[i - n]), f.high[i - n])

"""Takes of the fitted car itself, with the random pushes and the pose noise that a fit found.

For nulls, noise floors and manoeuvres: the same chain and the same body as the predictions, run through in one
piece.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.effects.car import Body
from bcid.effects.constants import Constants
from bcid.effects.measurement import seen_pose
from bcid.effects.motion import Chain, body_step, settled
from bcid.likelihood.hypothesis import Setting
from bcid.likelihood.marginal import Scales
from bcid.likelihood.take import GROUP_S, KNOT_S, KNOTS, N_FREE, SEGMENT_S, Take, unpushed
from bcid.physics.car import LONGEST_STEP_S, Car

# Commands are copied into every take: chains are remembered by the array they came from, whatever a take's length.

STILL = Scales(np.zeros(3), np.zeros(3))
"""No noise and no pushes."""


@njit
def pushed(start: Floats, pushes: Floats, chain: Chain, T: float, p: Car, e: Any, c: Constants) -> Floats:
    """States (n + 1, 6) at the chain's n steps, from `start` under `pushes` (K, 3), wrenches of KNOT_S each."""
    n = (len(chain.delta) - 1) // 2
    per_knot = round(KNOT_S / chain.h)
    out = np.empty((n + 1, 6))
    b = Body(start[0], start[1], start[2], start[3], start[4], start[5])
    lagged = settled(b, 0, chain, T, p, e, c)
    for i in range(n + 1):
        out[i, 0], out[i, 1], out[i, 2] = b.p_x, b.p_y, b.theta
        out[i, 3], out[i, 4], out[i, 5] = b.v_x, b.v_y, b.omega
        if i < n:
            push = pushes[min(i // per_knot, len(pushes) - 1)]
            b, lagged = body_step(b, lagged, i, chain, T, push, p, e, c)
    return out


@njit
def _seen(true: Floats, e: Any) -> Floats:
    """The tracked poses (P, 3) of `true` ones."""
    out = np.empty_like(true)
    for i in range(len(true)):
        out[i] = seen_pose(
            true[i, 0], true[i, 1], true[i, 2], e.marker_offset__d_x, e.marker_offset__d_y,
            e.body_yaw_misalignment__psi, e.pose_scale__kappa,
        )  # fmt: skip
    return out


def undriven(command_s: Floats, command: Floats, T: float, h: float = LONGEST_STEP_S) -> Take:
    """A take of commands (M, 2) at `command_s` (M,) without poses: enough for the `setting` of a hypothesis."""
    none, nothing = np.empty(0, dtype=np.int64), np.empty(0)
    return Take(
        command_s, command.copy(), nothing, none, nothing, np.zeros(1, dtype=np.int64), np.empty((0, 3)),
        np.zeros(1, dtype=np.int64), none, round(SEGMENT_S / h), T, np.empty((0, N_FREE)), nothing, nothing,
        np.zeros(len(command_s)),
    )  # fmt: skip


def states(setting: Setting, T: float, scales: Scales, seed: int, start: Floats) -> Floats:
    """True states (n + 1, 6) after every step of the chain, under pushes of sd `scales.q`, constant over KNOT_S."""
    car = setting.car
    knots = int(np.ceil(T / KNOT_S)) + KNOTS
    pushes = np.random.default_rng([seed, 0]).standard_normal((knots, 3)) * scales.q * [car.m, car.m, car.I_z]
    return np.asarray(pushed(start, pushes, setting.chain, T, car, setting.switches, setting.constants))


def seen_at(stamp: Floats, true: Floats, setting: Setting) -> Floats:
    """The tracked poses (P, 3) at `stamp` of true states (n + 1, 6) after every step of the chain."""
    from scipy.interpolate import CubicHermiteSpline

    if not np.isfinite(true).all():
        raise FloatingPointError("a simulated drive left the finite numbers")
    sin_t, cos_t = np.sin(true[:, 2]), np.cos(true[:, 2])
    v_x, v_y, omega = true[:, 3:].T
    rates = np.column_stack([cos_t * v_x - sin_t * v_y, sin_t * v_x + cos_t * v_y, omega])
    path = CubicHermiteSpline(np.arange(len(true)) * setting.chain.h, true[:, :3], rates)(stamp)
    return np.asarray(_seen(path, setting.switches))


def simulated_take(
    setting: Setting, command_s: Floats, command: Floats, T: float, scales: Scales, rate_hz: float, seed: int,
    start: Floats,
) -> Take:  # fmt: skip
    """The take that the car of `setting` gives from `start` (6,) on, seen at `rate_hz` for T seconds.

    `setting.chain` is that of these commands.  Poses have white noise such that a row's mean has the sd
    `scales.r`.  Segments follow each other from time zero; their starts are the true states there.
    """
    true = states(setting, T, scales, seed, start)
    S, steps = int(T / SEGMENT_S + 1e-9), round(SEGMENT_S / setting.chain.h)
    stamp = np.arange(int(np.ceil(S * SEGMENT_S * rate_hz - 1e-9))) / rate_hz
    path = seen_at(stamp, true, setting)
    group, row = np.unique(np.floor(stamp / GROUP_S + 1e-6).astype(np.int64), return_inverse=True)
    each = 1.0 / np.bincount(row)
    share = each[row]
    noise = np.random.default_rng([seed, 1]).standard_normal(path.shape) * scales.r
    seen = path + noise / np.sqrt(each.mean())
    per_segment = round(SEGMENT_S / GROUP_S)
    edges = np.arange(S + 1)
    step = np.arange(S, dtype=np.int64) * steps
    return Take(
        command_s, command.copy(), stamp, row.astype(np.int64), share,
        np.searchsorted(group[row] // per_segment, edges).astype(np.int64),
        np.column_stack([np.bincount(row, share * seen[:, c]) for c in range(3)]),
        np.searchsorted(group // per_segment, edges).astype(np.int64), step, steps, T, unpushed(true[step]),
        np.zeros(S), np.full(S, T), np.zeros(len(command_s)),
    )  # fmt: skip

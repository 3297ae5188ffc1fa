"""Simulated takes of a fitted car, with pushes and pose noise as large as a fit found them.

For takes of nothing, noise floors and manoeuvres: the actuators and the body of the predictions, integrated in one
piece.
"""

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.njit import njit
from bcid.effects.actuators import ActuatorChain, actuation_at
from bcid.effects.car import unpack_body
from bcid.effects.constants import Constants
from bcid.effects.measurement import tracked_pose
from bcid.effects.motion import integrate_body, steady_lags
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import GROUP_S, KNOT_S, KNOTS, N_NUISANCE, SEGMENT_S, Take, pad_with_zero_pushes
from bcid.physics.car import LONGEST_STEP_S, Car

# Commands are copied into every take, since actuator chains are cached by the array of commands that they belong to.

NO_NOISE = Scales(np.zeros(3), np.zeros(3))
"""Scales without noise and without pushes."""


@njit
def _integrate_states(
    start: Floats, pushes: Floats, chain: ActuatorChain, T: float, p: Car, e: Switches, c: Constants
) -> Floats:
    """Integrate the car's motion over an actuator chain's n steps: states (n + 1, 6) under given disturbances.

    A state is p_x, p_y, theta (world), v_x, v_y (body), omega; `start` (6,) is the first.  `pushes` (K, 3) are
    disturbance wrenches F_x, F_y (N), M_z (N m) in the body frame, each constant over KNOT_S.
    """
    n = (len(chain.delta) - 1) // 2
    per_knot = round(KNOT_S / chain.h)
    b = unpack_body(start)
    lags = steady_lags(b, actuation_at(0, chain, T), p, e, c)
    return integrate_body(b, lags, 0, n, chain, T, pushes, per_knot, p, e, c)[:, :6].copy()


@njit
def _apply_measurement(poses: Floats, e: Switches) -> Floats:
    """Poses (P, 3) that tracking reports for true poses (P, 3), both x, y (m), yaw (rad), without noise.

    The measurement effects in `e`, such as a marker offset or a yaw misalignment, are applied.
    """
    out = np.empty_like(poses)
    for i in range(len(poses)):
        out[i] = tracked_pose(poses[i, 0], poses[i, 1], poses[i, 2], e)
    return out


def commands_only_take(command_s: Floats, command: Floats, T: float, h: float = LONGEST_STEP_S) -> Take:
    """A take with commands (M, 2), steering (rad) and throttle, but no poses, as input of a simulation of `T` seconds.

    The times `command_s` (M,) and the integration step `h` are in s.
    """
    none, nothing = np.empty(0, dtype=np.int64), np.empty(0)
    return Take(
        command_s, command.copy(), nothing, none, nothing, np.zeros(1, dtype=np.int64), np.empty((0, 3)),
        np.zeros(1, dtype=np.int64), none, round(SEGMENT_S / h), T, np.empty((0, N_NUISANCE)), nothing, nothing,
        np.zeros(len(command_s)),
    )  # fmt: skip


def simulate_states(inputs: PredictionInputs, T: float, scales: Scales, seed: int, start: Floats) -> Floats:
    """Simulate a car for T seconds from the state `start` (6,) under random disturbances: states (n + 1, 6).

    A state is p_x, p_y, theta (world), v_x, v_y (body), omega.  Disturbances are Gaussian accelerations, constant over
    KNOT_S, with standard deviations `scales.q`, each correlated with the next by `scales.rho`, drawn from the `seed`.
    """
    car = inputs.car
    knots = int(np.ceil(T / KNOT_S)) + KNOTS
    pushes = draw_pushes(knots, scales, seed) * [car.m, car.m, car.I_z]
    return np.asarray(_integrate_states(start, pushes, inputs.chain, T, car, inputs.switches, inputs.constants))


def draw_pushes(knots: int, scales: Scales, seed: int) -> Floats:
    """Random accelerations (knots, 3) of the body, m/s^2 and rad/s^2: an autoregression with the scales' q and rho."""
    pushes = np.random.default_rng([seed, 0]).standard_normal((knots, 3)) * scales.q
    for k in range(1, knots):
        pushes[k] = scales.rho * pushes[k - 1] + np.sqrt(1.0 - scales.rho**2) * pushes[k]
    return pushes


def observe_states(stamp_s: Floats, states: Floats, inputs: PredictionInputs) -> Floats:
    """Poses (P, 3), x, y (m), yaw (rad), that tracking reports at times `stamp_s` (P,), without noise.

    They follow from true states (n + 1, 6), p_x, p_y, theta (world), v_x, v_y (body), omega at the integration steps,
    by cubic Hermite interpolation; the measurement effects in `inputs`, such as a marker offset, are applied.

    Raises:
        PredictionDiverged: a state is not finite.
    """
    from scipy.interpolate import CubicHermiteSpline

    require_finite("a simulated drive", states)
    sin_t, cos_t = np.sin(states[:, 2]), np.cos(states[:, 2])
    v_x, v_y, omega = states[:, 3:].T
    rates = np.column_stack([cos_t * v_x - sin_t * v_y, sin_t * v_x + cos_t * v_y, omega])
    path = CubicHermiteSpline(np.arange(len(states)) * inputs.chain.h, states[:, :3], rates)(stamp_s)
    return np.asarray(_apply_measurement(path, inputs.switches))


def simulate_take(
    inputs: PredictionInputs, command_s: Floats, command: Floats, T: float, scales: Scales, rate_hz: float,
    seed: int, start: Floats,
) -> Take:  # fmt: skip
    """Simulate a take of T seconds with `rate_hz` poses per second, under random disturbances and measurement noise.

    `inputs.chain` must belong to the commands (M, 2), steering (rad) and throttle; `start` is the state (6,) at time
    zero.  The white noise is scaled such that means of poses over GROUP_S have the standard deviations `scales.r` (m,
    m, rad).  Each segment's initial state is the true one.
    """
    true = simulate_states(inputs, T, scales, seed, start)
    S, steps = int(T / SEGMENT_S + 1e-9), round(SEGMENT_S / inputs.chain.h)
    stamp = np.arange(int(np.ceil(S * SEGMENT_S * rate_hz - 1e-9))) / rate_hz
    path = observe_states(stamp, true, inputs)
    group, row = np.unique(np.floor(stamp / GROUP_S + 1e-6).astype(np.int64), return_inverse=True)
    row_share = 1.0 / np.bincount(row)
    share = row_share[row]
    noise = np.random.default_rng([seed, 1]).standard_normal(path.shape) * scales.r
    poses = path + noise / np.sqrt(row_share.mean())
    per_segment = round(SEGMENT_S / GROUP_S)
    edges = np.arange(S + 1)
    step = np.arange(S, dtype=np.int64) * steps
    return Take(
        command_s, command.copy(), stamp, row.astype(np.int64), share,
        np.searchsorted(group[row] // per_segment, edges).astype(np.int64),
        np.column_stack([np.bincount(row, share * poses[:, c]) for c in range(3)]),
        np.searchsorted(group // per_segment, edges).astype(np.int64), step, steps, T, pad_with_zero_pushes(true[step]),
        np.zeros(S), np.full(S, T), np.zeros(len(command_s)),
    )  # fmt: skip

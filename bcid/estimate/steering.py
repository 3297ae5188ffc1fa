"""Time constant and rate limit of the steering, identified from the poses where the vehicle file omits them.

They are the values under which the commanded angle explains the yaw acceleration best.
"""

from collections.abc import Sequence

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.limits import LIMITS
from bcid.estimate.tuning import Origin, SteeringOrigin
from bcid.recording.checks import raw_motion
from bcid.recording.checks.clock import WINDOW_S, usable_rows, yaw_acceleration, yaw_acceleration_residuals
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

# Bounds of the search: T_s (s) and d (rad/s).
T_S_RANGE, D_RANGE = (0.02, 1.5), (0.1, 60.0)
# Time (s) at both ends of a take that is left out, where differences have no neighbours.
EDGE_MARGIN_S = 1.0


def identify_steering(recordings: Sequence[Recording], vehicle: Vehicle) -> tuple[float, float, SteeringOrigin]:
    """The steering's time constant T_s (s) and rate limit d (rad/s), and the origin of each.

    A constant that the vehicle file states is kept ("given").  Others are "identified" by nonlinear least squares on
    the residuals of the measured yaw acceleration.  Where no recording steers enough (`LIMITS.min_steering_sd_rad`,
    `min_steering_rows`), default constants are returned ("default").
    """
    from scipy.optimize import least_squares

    given = vehicle.steering
    free = [given.time_constant_s is None, given.max_rate_radps is None]
    start = np.log(
        [
            given.time_constant_s or raw_motion.DEFAULT_TIME_CONSTANT_S,
            given.max_rate_radps or raw_motion.DEFAULT_RATE_RADPS,
        ]
    )
    steered = [r for r in recordings if np.std(r.commands.values[:, 0]) > LIMITS.min_steering_sd_rad]
    motions = [(r, raw_motion.differentiate_poses(r, vehicle, WINDOW_S)) for r in steered]
    motions = [(r, m) for r, m in motions if len(m.time_s) > LIMITS.min_steering_rows]

    def origins(source: Origin) -> dict[str, Origin]:
        return {symbol: source for symbol, absent in zip(("T_s", "d"), free, strict=True) if absent}

    def constants(x: Floats) -> tuple[float, float]:
        full = start.copy()
        full[free] = x
        return float(np.exp(full[0])), float(np.exp(full[1]))

    if not any(free) or not motions:
        return *constants(start[free]), SteeringOrigin(**origins("default"))
    low, high = np.log([T_S_RANGE, D_RANGE]).T[:, free]

    def residuals(x: Floats) -> Floats:
        return np.concatenate([_recording_residuals(r, m, vehicle, *constants(x)) for r, m in motions])

    fits = [
        least_squares(residuals, x_0[free], bounds=(low, high), diff_step=[1e-2] * sum(free))
        for x_0 in (start, start + np.log([0.4, 0.5]), start + np.log([2.0, 3.0]))
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    T_s, d = constants(best.x)
    near = [np.isclose(best.x, bound, atol=LIMITS.steering_bound_ln).any() for bound in (low, high)]
    reached = any(_reaches_rate_limit(r, m, vehicle, T_s, d) for r, m in motions)
    return T_s, d, SteeringOrigin(**origins("identified"), at_bound=any(near), rate_reached=reached)


def _recording_residuals(
    recording: Recording, motion: raw_motion.RawMotion, vehicle: Vehicle, T_s: float, d: float
) -> Floats:
    """Residuals (rad/s^2) of the yaw acceleration's regression on wheel forces, for a steering with T_s (s), d (rad/s).

    The steering angle comes from the commands by the time constant T_s and rate limit d.  There is one residual for
    each row of `motion` (derivatives of the raw poses) that is fast, under a command, far from gaps, and EDGE_MARGIN_S
    from either end.
    """
    delta = raw_motion.commanded_steering_angle(recording, vehicle, motion.time_s, T_s, d)
    margin = round(EDGE_MARGIN_S / float(motion.time_s[1] - motion.time_s[0]))
    rows, throttle = usable_rows(motion, recording, margin), recording.commands.held_at(motion.time_s)[:, 1]
    return yaw_acceleration_residuals(motion, delta, throttle, yaw_acceleration(motion), rows, vehicle)


def _reaches_rate_limit(
    recording: Recording, motion: raw_motion.RawMotion, vehicle: Vehicle, T_s: float, d: float
) -> bool:
    """Whether the commands ever turn the steering, simulated with T_s (s), as fast as its rate limit d (rad/s)."""
    delta = raw_motion.commanded_steering_angle(recording, vehicle, motion.time_s, T_s, d)
    rate = np.abs(np.diff(delta) / np.diff(motion.time_s))
    return bool(np.any(rate > LIMITS.rate_reached_share * d))

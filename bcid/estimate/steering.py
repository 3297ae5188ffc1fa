"""Time constant and rate limit of the steering, identified from the poses where the vehicle file omits them.

They are the values under which a single-track car, led along its measured speed, turns as the car did
(`bcid.recording.checks.steering_fit`): no filter's length and no vehicle's size biases them.
"""

from collections.abc import Sequence

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.limits import LIMITS
from bcid.estimate.tuning import Origin, SteeringOrigin
from bcid.recording.checks import raw_motion
from bcid.recording.checks.single_track import servo_angles
from bcid.recording.checks.steering_fit import SteeringFit, fit_steering
from bcid.recording.checks.turning import TurningData, liveliest, prepare_turning
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

# Bounds of what is found: T_s (s), below which the models' integration is unstable, and d (rad/s).
T_S_RANGE, D_RANGE = (0.02, 1.5), (0.1, 60.0)
NO_LIMIT_RADPS = 200.0  # faster than any servo: as good as no rate limit


def identify_steering(recordings: Sequence[Recording], vehicle: Vehicle) -> tuple[float, float, SteeringOrigin]:
    """The steering's time constant T_s (s) and rate limit d (rad/s), and the origin of each, with 95 % intervals.

    A constant that the vehicle file states is kept ("given").  Others are "identified" where the recordings show them,
    without an interval where one ends at a bound of its search.  What they do not show is "default": the documented
    time constant; a rate limit that the commands never reach, with which the steering moves as without any.  A dead
    time, or a clock that is a little off, is fitted beside them, so that it is not taken for the servo's lag.
    """
    given = vehicle.steering
    stated = {"T_s": given.time_constant_s, "d": given.max_rate_radps}
    fixed = {name: value for name, value in stated.items() if value is not None}
    T_s = given.time_constant_s or raw_motion.DEFAULT_TIME_CONSTANT_S
    d = given.max_rate_radps or raw_motion.DEFAULT_RATE_RADPS
    takes = [] if len(fixed) == len(stated) else _lively_takes(recordings, vehicle)
    fit = fit_steering(takes, vehicle, fixed) if takes else None
    if fit is None or fit.explained < LIMITS.min_turning_explained:
        return T_s, d, SteeringOrigin(**_origins(fixed, "default"))
    reached = True
    if "d" not in fixed:
        unlimited = fit_steering(takes, vehicle, {**fixed, "d": NO_LIMIT_RADPS}, start=fit.theta)
        reached = _shows_rate_limit(fit, unlimited)
        fit = fit if reached else unlimited
    origin = _origins(fixed, "identified")
    T_s_ci95 = d_ci95 = None
    at_bound = list[str]()
    if "T_s" not in fixed:
        sd = float(np.hypot(fit.sd("T_s"), LIMITS.servo_systematic_ln))
        sd = float(np.hypot(sd, LIMITS.servo_systematic_steps * takes[0].step_s / fit.value("T_s")))
        # of a servo that is faster than the bound in any case, not even the size need be known
        if sd < LIMITS.max_servo_sd_ln or fit.value("T_s") * np.exp(1.96 * sd) < T_S_RANGE[0]:
            T_s, T_s_ci95 = _within(fit.value("T_s"), sd, T_S_RANGE)
            at_bound += ["T_s"] * (T_s_ci95 is None)
        else:
            origin["T_s"] = "default"
    if "d" not in fixed and reached:
        d, d_ci95 = _within(fit.value("d"), float(np.hypot(fit.sd("d"), LIMITS.rate_systematic_ln)), D_RANGE)
        at_bound += ["d"] * (d_ci95 is None)
    elif "d" not in fixed:
        origin["d"] = "default"
        fastest = LIMITS.unreached_rate_factor * max(_fastest(t, fit) for t in takes)
        d = float(np.clip(fastest, raw_motion.DEFAULT_RATE_RADPS, D_RANGE[1]))
    rate_reached = reached if "d" not in fixed else None
    return T_s, d, SteeringOrigin(
        **origin, at_bound=tuple(at_bound), rate_reached=rate_reached, T_s_ci95=T_s_ci95, d_ci95=d_ci95
    )  # fmt: skip


def _within(value: float, sd_ln: float, bounds: tuple[float, float]) -> tuple[float, tuple[float, float] | None]:
    """A fitted value kept within `bounds`, and its 95 % interval by the standard deviation of its natural logarithm.

    There is no interval where a bound is met: the value that fits best lies beyond it.
    """
    low, high = bounds
    if not low <= value <= high:
        return float(np.clip(value, low, high)), None
    return value, (value * float(np.exp(-1.96 * sd_ln)), value * float(np.exp(1.96 * sd_ln)))


def _origins(fixed: dict[str, float], source: Origin) -> dict[str, Origin]:
    """The origin of T_s and of d by name: "given" for what is `fixed`, `source` for the others."""
    return {name: "given" if name in fixed else source for name in ("T_s", "d")}


def _lively_takes(recordings: Sequence[Recording], vehicle: Vehicle) -> list[TurningData]:
    """The liveliest parts of the recordings that steer most, at most `LIMITS.max_servo_takes` of them."""
    steered = [r for r in recordings if np.std(r.commands.values[:, 0]) > LIMITS.min_steering_sd_rad]
    steered.sort(key=lambda r: -float(np.std(r.commands.values[:, 0])))
    found = [prepare_turning(r, vehicle) for r in steered[: LIMITS.max_servo_takes]]
    parts = [liveliest(take, LIMITS.servo_take_s) for take in found if take is not None]
    return [part for part in parts if len(part.rows) > LIMITS.min_steering_rows]


def _shows_rate_limit(fit: SteeringFit, unlimited: SteeringFit) -> bool:
    """Whether the turning is explained clearly better with a rate limit than without any (likelihood ratio)."""
    nats = fit.misfit * float(np.log((unlimited.scale / fit.scale) ** 2))
    return nats > LIMITS.min_rate_nats and fit.sd("d") < LIMITS.max_servo_sd_ln


def _fastest(take: TurningData, fit: SteeringFit) -> float:
    """The fastest rate (rad/s) at which the fitted servo turns in a take."""
    angle: Floats = servo_angles(take.command_s, take.u_s, take.time_s, fit.value("T_s"), fit.value("d"), 0.0)
    return float(np.max(np.abs(np.diff(angle)))) / take.step_s

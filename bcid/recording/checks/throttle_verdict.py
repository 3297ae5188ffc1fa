"""Whether the throttle commands are those that this car was driven by: how much of its acceleration they explain.

The acceleration is explained by speed and turning alone (drag, slipping tyres) and then by the throttle, too, as by a
motor that answers at once; the filter of both is longer than any motor's lag.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.agreement import Feature, LagScan, scan_lags
from bcid.recording.checks.commanded_motion import GRID_HZ, CommandedMotion, away_from_unknown, smoothed
from bcid.recording.checks.limits import AGREEMENT as LIMITS
from bcid.vehicle import Vehicle

MEND_DEAD = "log the throttle that is sent to the motor, and drive again"
MEND_UNIT = 'map it with a gain in the vehicle file, or set law = "force" in [motor]'


class ThrottleAgreement(NamedTuple):
    """What the throttle explains of the acceleration beyond drag, and what is wrong with it."""

    share: float = 0.0
    lag_s: float = 0.0
    best_lag_s: float = 0.0  # of the lag at which it explains most
    verdict: str | None = None  # a cause and what mends it
    warning: str | None = None
    follows: bool = False  # whether the speed is the higher the more throttle there is


def judge_throttle(motion: CommandedMotion, vehicle: Vehicle, steering_lag_s: float | None) -> ThrottleAgreement:
    """How much of the acceleration the throttle explains, with a verdict where it cannot be this car's.

    `steering_lag_s` is the lag (s) at which the steering commands agree with the motion; None where they do not.
    """
    u_m, use = motion.commands[:, 1], motion.use & motion.known
    if use.sum() < LIMITS.least_judged_s * GRID_HZ:
        return ThrottleAgreement()
    scan, simple = _scan(motion, rich=True), _scan(motion, rich=False)
    reach = LIMITS.near_s * GRID_HZ
    middle = 0.0 if steering_lag_s is None else steering_lag_s * GRID_HZ
    far = LIMITS.max_short_offset_s * GRID_HZ
    near, best = scan.best(middle - reach, middle + reach), scan.best(middle - far, middle + far)
    share, lag_s = float(scan.share[near]), float(scan.lags[near]) / GRID_HZ
    best_lag_s = float(scan.lags[best]) / GRID_HZ
    left = float(scan.left[near]) * max(1.0 - share, 0.0) - motion.pull_noise**2
    unexplained = float(np.sqrt(max(left, 0.0))) / motion.top_speed
    agreement = ThrottleAgreement(share, lag_s, best_lag_s)
    if np.std(u_m[use]) < 1e-3 * max(float(np.abs(u_m).max()), 1e-9):
        return agreement._replace(verdict=_judge_steady(motion, unexplained))
    null = scan.null_share(LIMITS.null_from_s * GRID_HZ)
    k = simple.best(middle - reach, middle + reach)
    window = np.abs(simple.lags - middle) <= reach
    gains = simple.weights[:, -1]
    gain, rising = float(gains[k]), float(np.max(simple.share[window & (gains > 0.0)], initial=0.0))
    moved, moved_known = motion.commands_at(lag_s)
    both = motion.use & moved_known
    follows = both.sum() > 1 and float(np.corrcoef(moved[both, 1], motion.speed[both])[0, 1]) > 0.0
    agreement = agreement._replace(follows=follows)
    # what rises and falls slowly fits with either sign, a little earlier or later
    inverted = gain < 0.0 and rising < 0.5 * simple.share[k] and not follows
    if inverted and simple.share[k] > max(LIMITS.foreign_throttle_share, null):
        text = "the car slows where the throttle rises: its sign is inverted; map it with the other sign"
        return agreement._replace(verdict=text)
    verdict, warning = _judge_unit(motion, vehicle, lag_s)
    agreement = agreement._replace(warning=warning)
    if verdict is not None:
        return agreement._replace(verdict=verdict)
    varies = float(np.std(u_m[use])) > LIMITS.least_throttle_spread * float(np.abs(u_m).max())
    least = LIMITS.least_varied_pull if varies else LIMITS.least_pull
    if share < LIMITS.foreign_throttle_share and unexplained > least:
        if scan.share[best] > max(2.0 * LIMITS.foreign_throttle_share, null + LIMITS.better_share):
            text = f"the throttle fits the motion {_late_or_early(best_lag_s)} than stamped: it has another clock"
            return agreement._replace(verdict=f"{text}; log both commands by one clock")
        text = f"the throttle explains {share:.0%} of the acceleration: it is another take's, or dead; {MEND_DEAD}"
        return agreement._replace(verdict=text)
    return agreement


def _late_or_early(lag_s: float) -> str:
    """The offset of commands that fit `lag_s` (s) later than stamped, in words."""
    return f"{abs(lag_s):.1f} s {'later' if lag_s > 0.0 else 'earlier'}"


def _scan(motion: CommandedMotion, rich: bool) -> LagScan:
    """What the throttle explains of the acceleration at each lag; if not `rich`, by one gain only, the last weight."""
    v, w, u = motion.speed, motion.turn, motion.commands[:, 1]
    one, top = np.ones(len(v)), max(float(np.abs(u).max()), 1e-9)
    drive, brake = np.maximum(u, 0.0) / top, np.minimum(u, 0.0) / top
    drag = [Feature(smoothed(x), None) for x in (one, v, v * np.abs(v), np.abs(w) * v, w * w)]
    gain, braking = Feature(one, smoothed(drive)), Feature(smoothed(v), smoothed(brake))
    more = [Feature(one, smoothed(drive**2)), Feature(smoothed(v), smoothed(drive)), Feature(one, smoothed(brake))]
    moving = [*more, gain, braking] if rich else [Feature(one, smoothed(u / top))]
    return scan_lags(motion.pull, motion.use, [*drag, *moving], away_from_unknown(motion.known))


def _judge_steady(motion: CommandedMotion, unexplained: float) -> str | None:
    """The verdict on a throttle that never changes; None where speed, drag and turning explain the acceleration.

    `unexplained` is the acceleration by the top speed (1/s) that they leave.
    """
    value = float(np.median(motion.commands[motion.use & motion.known, 1]))
    if value <= 0.0:
        return f"the throttle stays at {value:.3g} while the car drives: it is dead; {MEND_DEAD}"
    if unexplained > LIMITS.least_pull:
        return f"the throttle stays at {value:.3g} while the car speeds up and brakes: it is dead; {MEND_DEAD}"
    return None


def _judge_unit(motion: CommandedMotion, vehicle: Vehicle, lag_s: float) -> tuple[str | None, str | None]:
    """The verdict, and the warning, on a throttle that is no reference speed in m/s though the vehicle file says so."""
    commands, known = motion.commands_at(lag_s)
    u = commands[:, 1]
    use = motion.use & known & (u > 0.0) & (motion.speed > 0.0)
    if vehicle.motor.law != "speed" or use.sum() < 5 * GRID_HZ:
        return None, None
    high = float(np.quantile(u[use], 0.95))
    if high > LIMITS.max_throttle_ratio * motion.top_speed:
        meant = "PWM in µs" if high > LIMITS.least_pwm else "percent"
        reached = f"the throttle reaches {high:.3g} where the car reaches {motion.top_speed:.2g} m/s"
        return f"{reached}: it is in {meant}, not m/s; {MEND_UNIT}", None
    largest = float(motion.commands[:, 1].max())
    if largest <= LIMITS.max_duty and motion.top_speed > LIMITS.max_passed * largest:
        passed = f"the car drives {motion.top_speed:.2g} m/s and no throttle asks for more than {largest:.2g}"
        return f"the throttle is a duty in 0..1, not a speed in m/s: {passed}; {MEND_UNIT}", None
    clear = use & (motion.pull > 0.5 * float(np.std(motion.pull[motion.use])))
    outruns = float((clear & (motion.speed > LIMITS.outrun * u)).sum() / max(clear.sum(), 1))
    if clear.sum() < 2 * GRID_HZ or outruns < LIMITS.max_outrun_share:
        return None, None
    text = f"the car speeds up beyond the speed that the throttle asks for in {outruns:.0%} of its accelerations"
    return None, f"{text}: it is no speed in m/s; {MEND_UNIT}"


def exchange_commands(motion: CommandedMotion) -> CommandedMotion:
    """The motion with its steering and throttle commands exchanged."""
    commands: Floats = np.ascontiguousarray(motion.commands[:, ::-1])
    return motion._replace(commands=commands)

"""Values that no such car can have: units, signs and ranges judged by the motion itself."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused, Problem, Problems
from bcid.recording.checks.limits import AGREEMENT
from bcid.recording.checks.raw_motion import (
    commanded_steering_angle,
    differentiate_poses,
    moves_backward,
    reverses_by_motor,
)
from bcid.recording.checks.steering_verdict import SteeringAgreement, compare_steering
from bcid.recording.limits import MOTION as LIMITS
from bcid.recording.types import BRAKE_CHANNEL, Irregularity, Recording, Stream, command_source_path
from bcid.vehicle import Vehicle

MISREADINGS = {
    "an axis is mirrored (x)": (-1.0, 1.0, 1.0),
    "an axis is mirrored (y)": (1.0, -1.0, 1.0),
    "yaw is clockwise": (1.0, 1.0, -1.0),
}
"""Other ways in which the pose may have been written: factors of x, y, yaw."""
SET_UNIT = "set the unit (mocap.length_unit, or a gain in [columns]) or correct the vehicle file"
N_CHANNEL_LAGS = 21  # tried between the largest delays of a channel
CHANNEL_REFERENCES = {
    "measured_steering_rad": ("the commanded angle", "log it in rad, positive to the left"),
    "wheel_speed_mps": ("the speed of the front axle", "log it in m/s, positive forward"),
    "yaw_rate_radps": ("the yaw rate of the poses", "log it in rad/s, positive counter-clockwise"),
}
"""What each channel is compared with, and how it should be logged."""


def check_plausibility(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording with warnings where its motion suggests a wrong unit, sign or measured channel.

    Raises:
        InputRefused: the motion shows inverted steering, a mirrored axis, or a wrong unit of lengths, yaw or a channel.
    """
    problems, odd = Problems(), list[Irregularity]()
    with problems.gather_refusals():
        _check_brake(recording)
    with problems.gather_refusals():
        odd += _check_turning(recording, vehicle)
        odd += _check_speed(recording, vehicle)
    with problems.gather_refusals():
        _check_measured_throttle(recording, vehicle)
        odd += _check_channels(recording, vehicle)
    problems.raise_if_any(recording.sources[0].path)
    return replace(recording, irregularities=(*recording.irregularities, *odd))


def check_commands(commands: Floats, vehicle: Vehicle, source: str) -> list[Irregularity]:
    """Warnings of steering (rad) and throttle commands (m/s, or brake share) (M, 2) that exceed the car's limits.

    Raises:
        InputRefused: commands exceed the limits so far that another unit must be meant, such as degrees or percent.
    """
    problems, odd = Problems(), list[Irregularity]()
    with problems.gather_refusals():
        odd = _check_steering(commands[:, 0], vehicle.steering.max_angle_rad, source)
    with problems.gather_refusals():
        _check_throttle(commands[:, 1], vehicle, source)
    problems.raise_if_any(source)
    return odd


def _check_throttle(u_m: Floats, vehicle: Vehicle, source: str) -> None:
    """Raise `InputRefused` where throttles u_m (M,) are neither possible reference speeds (m/s) nor brake shares.

    Brake shares lie in [-1, 0]; where the vehicle reverses, throttles below 0 are speeds as well.  Only vehicles with
    the motor law "speed" are checked.
    """
    if vehicle.motor.law != "speed":
        return
    top = vehicle.motor.reference_speed_mps
    if top is not None and u_m.max() > LIMITS.max_throttle_factor * top:
        cause = f"reaches {u_m.max():.3g}, the largest reference speed is {top:g} m/s: percent?"
        raise InputRefused(source, "throttle_mps", cause, "log the throttle in m/s, or map it with a gain")
    lowest = float(u_m.min())
    if vehicle.motor.reverses:
        if top is not None and lowest < -LIMITS.max_throttle_factor * top:
            cause = f"falls to {lowest:.3g}, the largest reference speed is {top:g} m/s, forward and backward: percent?"
            raise InputRefused(source, "throttle_mps", cause, "log the throttle in m/s, or map it with a gain")
    elif lowest < LIMITS.min_brake_share:
        cause = f"falls to {lowest:.3g}, where below 0 a brake share in [-1, 0] is meant"
        step = "a car that reverses has reverses = true in [motor]; or map the field with gain, offset and low"
        raise InputRefused(source, "throttle_mps", cause, step)


def _check_steering(u_s: Floats, limit: float, source: str) -> list[Irregularity]:
    """How many steering commands u_s (M,) ask for more than the `limit` (rad); `InputRefused` if they are in degrees.

    Planners ask beyond the stop, where the servo stays; but not for several times as much and a quarter turn, or half a
    turn.
    """
    high = float(np.quantile(np.abs(u_s), 0.95))
    asked = max(LIMITS.max_steering_factor * limit, LIMITS.min_degrees)
    if high > min(asked, LIMITS.max_asked_steering_rad):
        cause = f"reaches {high:.3g} where the car's limit is {limit:.3g} rad: degrees?"
        step = (
            "log the command in rad (a table or MCAP field can be mapped with gain = 0.017453), "
            "or put max_angle_rad in [steering] of the vehicle file right"
        )
        raise InputRefused(source, "steering_rad", cause, step)
    beyond = np.abs(u_s) > limit * (1.0 + LIMITS.max_rounding)
    if not beyond.any():
        return []
    text = f"commands beyond the limit of {limit:g} rad, up to {np.abs(u_s).max():.3g}, act as the limit"
    return [Irregularity("steering command", "fixed", int(beyond.sum()), source, text)]


class _TurningResponse(NamedTuple):
    """How a car turns as it is steered: omega L is about v sin(delta)."""

    correlation: float  # of yaw rate and commanded turning, about zero
    heading: float  # 1 where the front wheel moves where it is steered but for a constant angle, 0 where it does not
    wheelbase_m: float | None  # as the motion shows it


def _turning_response(recording: Recording, vehicle: Vehicle) -> _TurningResponse | None:
    """How the car turns as its steering is commanded: correlation, agreement of direction, and apparent wheelbase (m).

    The correlation is that of yaw rate and v sin(delta).  The agreement is |mean exp(i (beta_f - delta))|, 1 where
    the front axle's direction of motion beta_f equals the steering angle delta up to a constant.  None where the car
    turns too little (`MOTION.min_commanded_turn`, `min_yaw_rate_radps`, `min_turning_rows`).
    """
    motion = differentiate_poses(recording, vehicle)
    if len(motion.time_s) < 2 or not motion.good.any():
        return None
    angle = commanded_steering_angle(recording, vehicle, motion.time_s)
    # the CoG's speed: the front axle's holds yaw rate * l_f, whatever the unit of lengths
    v_x = motion.v_f * np.cos(motion.beta_f)
    speed = np.hypot(v_x, motion.v_f * np.sin(motion.beta_f) - vehicle.body.cog_to_front_m * motion.yaw_rate)
    use = motion.good & (speed > LIMITS.min_speed_share * np.quantile(speed[motion.good], 0.95))
    folded = 1.0
    if reverses_by_motor(vehicle):
        # backward, it turns right where it is steered left
        back = moves_backward(motion.beta_f, motion.good * motion.v_f)
        # a whole drive backward is one of a body that is mounted so, too
        if back[use].mean() < AGREEMENT.max_backward_share or _turns_as_backward(speed, angle, motion.yaw_rate, use):
            angle = np.where(back, angle + np.pi, angle)
        folded = 2.0
    turn, yaw_rate = speed[use] * np.sin(angle[use]), motion.yaw_rate[use]
    size, rate = (float(np.sqrt(np.mean(x**2))) for x in (turn, yaw_rate)) if use.any() else (0.0, 0.0)
    turns_little = size < LIMITS.min_commanded_turn * np.max(speed[motion.good]) or rate < LIMITS.min_yaw_rate_radps
    if use.sum() < LIMITS.min_turning_rows or turns_little:
        return None
    # forward or backward is the same direction for wheels that cannot turn so far
    heading = abs(np.mean(np.exp(folded * 1j * (motion.beta_f - angle)[use])))
    correlation = float(turn @ yaw_rate) / (size * rate * len(turn))
    return _TurningResponse(correlation, float(heading), _apparent_wheelbase(turn, yaw_rate, speed[use], vehicle))


def _turns_as_backward(speed: Floats, angle: Floats, yaw_rate: Floats, use: Bools) -> bool:
    """Whether a car turns right where its `angle` (N,) is to the left in the rows `use` (N,), as it does backward."""
    return float((speed * np.sin(angle))[use] @ yaw_rate[use]) < 0.0


def _apparent_wheelbase(turn: Floats, yaw_rate: Floats, speed: Floats, vehicle: Vehicle) -> float | None:
    """Wheelbase (m) that the motion shows: the ratio of the norms of v sin(delta) and yaw rate; None with too few rows.

    `turn` (N,) is v sin(delta) (m/s).  A regression's slope would be biased by a servo slower than stated, the ratio
    of norms is not.  It is computed from all rows and from those of small lateral acceleration, as tyre slip makes a
    car seem longer; the value nearer to the vehicle file's wheelbase is returned.
    """
    stated = vehicle.body.wheelbase_m
    found = []
    for part in (np.ones(len(turn), dtype=bool), np.abs(speed * yaw_rate) < LIMITS.gentle_lateral_mps2):
        size, rate = np.linalg.norm(turn[part]), np.linalg.norm(yaw_rate[part])
        if part.sum() > LIMITS.min_turning_rows and size > 0.0 and rate > 0.0:
            found.append(float(size / rate))
    return min(found, key=lambda length: abs(np.log(length / stated)), default=None)


def _check_turning(recording: Recording, vehicle: Vehicle) -> list[Irregularity]:
    """A warning where steering commands explain little of the recording's turning; none where it hardly turns.

    Raises:
        InputRefused: the steering or an axis is inverted, or lengths or angles are in another unit.
    """
    seen, source = _turning_response(recording, vehicle), recording.sources[0].path
    if seen is None:
        return []
    inverted, askew = seen.correlation < -LIMITS.min_turning_correlation, seen.heading < LIMITS.min_heading_agreement
    steering = compare_steering(recording, vehicle) if inverted or askew else SteeringAgreement()
    if inverted and not (steering.fits_at_another_time or steering.fits_in_part or steering.foreign):
        raise InputRefused(
            source, "steering", f"the car turns right where the command says left (correlation {seen.correlation:.2f})",
            "positive steering turns left: log or map the command with the other sign, or correct up_axis or the order "
            "of the quaternions (x, y, z, w)",
        )  # fmt: skip
    # steered in waves, commands of another time fit a mirrored motion as well
    if askew and not steering.fits_at_another_time:
        agreements = dict[str, float]()
        for name, factors in MISREADINGS.items():
            poses = Stream(recording.poses.time_s, recording.poses.values * np.array(factors))
            mirrored = _turning_response(replace(recording, poses=poses), vehicle)
            agreements[name] = 0.0 if mirrored is None else mirrored.heading
        best = max(agreements.values())
        if best > LIMITS.min_mirrored_agreement:
            # a mirrored axis and a clockwise yaw are the same but for the world's own reflection
            names = " or ".join(n for n, agreement in agreements.items() if agreement > best - LIMITS.same_agreement)
            cause = f"the car moves where it is steered only if {names} (agreement {seen.heading:.2f}, then {best:.2f})"
            raise InputRefused(source, "pose", cause, "correct up_axis, or the axes of the pose")
    if seen.correlation < LIMITS.min_turning_correlation or askew:
        figures = f"(turning {seen.correlation:.2f}, heading {seen.heading:.2f})"
        text = f"the commands explain little of the motion {figures}: check axes and units"
        return [Irregularity("steering response", "warning", 1, source, text)]
    stated, factor = vehicle.body.wheelbase_m, LIMITS.max_scale_factor
    if seen.wheelbase_m and not stated / factor < seen.wheelbase_m < stated * factor:
        shown = f"the car turns as if its wheelbase were {seen.wheelbase_m:.3g} m"
        cause = f"{shown}, the vehicle file says {stated:.3g} m: lengths in mm or cm, or yaw in degrees?"
        raise InputRefused(source, "pose", cause, SET_UNIT)
    return []


def _check_speed(recording: Recording, vehicle: Vehicle) -> list[Irregularity]:
    """A warning where the car's speed exceeds `MOTION.max_speed_factor` times the largest reference speed of its motor.

    Raises:
        InputRefused: the speed exceeds `MOTION.max_scale_factor` times that, as if lengths were in mm or cm.
    """
    top, motion = vehicle.motor.reference_speed_mps, differentiate_poses(recording, vehicle)
    if top is None or vehicle.motor.law != "speed" or not motion.good.any():
        return []
    # not the front axle's, which a yaw in degrees makes fast
    across = motion.v_f * np.sin(motion.beta_f) - vehicle.body.cog_to_front_m * motion.yaw_rate
    speed = np.hypot(motion.v_f * np.cos(motion.beta_f), across)
    fast = float(np.quantile(speed[motion.good], 0.99))
    if fast < LIMITS.max_speed_factor * top:
        return []
    source = recording.sources[0].path
    text = f"the car reaches {fast:.3g} m/s, the motor's largest is {top:g} m/s"
    if fast > LIMITS.max_scale_factor * top:
        raise InputRefused(source, "pose", f"{text}: lengths in mm or cm?", SET_UNIT)
    asked = float(recording.commands.values[:, 1].max())
    if asked > top:
        text = f"{text}, and throttles ask for up to {asked:.3g} m/s: correct motor.reference_speed_mps"
        return [Irregularity("vehicle file", "warning", 1, source, text)]
    return [Irregularity("scale", "warning", 1, source, f"{text}: a scale set on export?")]


def _check_brake(recording: Recording) -> None:
    """Raise `InputRefused` where the channel of a brake of its own is no share from 0 to 1."""
    if BRAKE_CHANNEL not in recording.channels:
        return
    share = recording.channels[BRAKE_CHANNEL].values
    low, high = float(share.min()), float(share.max())
    if low < -LIMITS.max_rounding or high > 1.0 + LIMITS.max_rounding:
        cause = f"goes from {low:.3g} to {high:.3g}, where a share from 0 to 1 is meant: percent?"
        step = "log it so, or map the field with a gain"
        raise InputRefused(command_source_path(recording.sources), BRAKE_CHANNEL, cause, step)


def _check_measured_throttle(recording: Recording, vehicle: Vehicle) -> None:
    """Raise `InputRefused` where the throttle is a measured wheel speed in another unit than m/s.

    A wheel that spins is faster than the car, too, but not for half of a drive as much as by another unit.
    """
    if vehicle.motor.law != "measured-speed":
        return
    motion, factor = differentiate_poses(recording, vehicle), LIMITS.max_channel_factor
    use = motion.good & (motion.v_f > LIMITS.min_speed_share * np.quantile(motion.v_f, 0.95))
    if use.sum() < LIMITS.min_channel_rows:
        return
    told = np.abs(recording.commands.held_at(motion.time_s)[:, 1])
    times = float(np.median(told[use]) / np.median(motion.v_f[use]))
    max_lag = round(LIMITS.max_channel_delay_s / motion.step_s)
    follows = _strongest_lagged_correlation(motion.v_f, told, motion.good, max_lag) > LIMITS.min_channel_correlation
    if follows and not 1.0 / factor < times < factor:
        cause = f"is {times:.3g} times the speed of the car: km/h, cm/s, or turns of the wheel?"
        step = f"log the wheel's speed in m/s, or map it with the gain of its unit, about {1.0 / times:.3g}"
        raise InputRefused(command_source_path(recording.sources), "throttle_mps", cause, step)


def _check_channels(recording: Recording, vehicle: Vehicle) -> list[Irregularity]:
    """Warnings of channels (measured steering, wheel speed, yaw rate) that do not follow the motion of the poses.

    Raises:
        InputRefused: a channel's unit or sign seems wrong.
    """
    if not recording.channels:
        return []
    motion, odd = differentiate_poses(recording, vehicle), list[Irregularity]()
    if len(motion.time_s) < LIMITS.min_channel_rows:
        return []
    problems, unit_factor = Problems(), LIMITS.max_channel_factor
    for name, stream in recording.channels.items():
        if name not in CHANNEL_REFERENCES:
            continue
        what, hint = CHANNEL_REFERENCES[name]
        if name == "measured_steering_rad":
            expected = commanded_steering_angle(recording, vehicle, motion.time_s)
        else:
            expected = motion.yaw_rate if name == "yaw_rate_radps" else motion.v_f
        seen = np.interp(motion.time_s, stream.time_s, stream.values[:, 0])
        inside = (motion.time_s >= stream.time_s[0]) & (motion.time_s <= stream.time_s[-1])
        if name == "wheel_speed_mps":
            seen = np.abs(seen)  # what the poses say has no sign
        use = motion.good & inside
        x, y = expected[use], seen[use]
        if len(x) < LIMITS.min_channel_rows or x.std() < 1e-6:
            continue
        if y.std() < 1e-12:
            odd.append(Irregularity("channel", "warning", 1, name, f"does not change, {what} does"))
            continue
        max_lag = round(LIMITS.max_channel_delay_s / motion.step_s)
        correlation = _strongest_lagged_correlation(expected, seen, use, max_lag)
        times = float(np.sqrt((y @ y) / (x @ x)))
        if correlation < -LIMITS.min_channel_correlation:
            cause = f"runs against {what} (correlation {correlation:.2f}): its sign is inverted"
            problems.append(Problem(name, cause, hint))
        elif abs(correlation) < LIMITS.min_channel_correlation:
            text = f"does not follow {what} (correlation {correlation:.2f})"
            odd.append(Irregularity("channel", "warning", 1, name, text))
        elif correlation > LIMITS.min_channel_correlation and not 1.0 / unit_factor < times < unit_factor:
            problems.append(Problem(name, f"is {times:.3g} times {what}: degrees, or mm?", hint))
    problems.raise_if_any(command_source_path(recording.sources))
    return odd


def _strongest_lagged_correlation(x: Floats, y: Floats, use: Bools, max_lag: int) -> float:
    """Correlation of largest size between x (N,) and y (N,) in the rows `use`, y shifted by up to `max_lag` rows."""
    found = []
    for shift in np.unique(np.linspace(-max_lag, max_lag, N_CHANNEL_LAGS).round().astype(int)):
        late = np.roll(y, -shift)
        kept = use.copy()
        kept[len(kept) - shift if shift > 0 else 0 : len(kept) if shift > 0 else -shift] = False
        if kept.sum() >= LIMITS.min_channel_rows and late[kept].std() > 0.0:
            found.append(float(np.corrcoef(x[kept], late[kept])[0, 1]))
    return max(found, key=abs, default=0.0)

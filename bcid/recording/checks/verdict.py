"""What of a recording cannot be used, and why: poses, steering and throttle against each other, in this order.

A verdict is an irregularity whose action is "no-go": the likely cause first, then what would mend it.
"""

from dataclasses import replace

import numpy as np

from bcid.errors import InputRefused
from bcid.recording.checks.commanded_motion import compare_on_grid
from bcid.recording.checks.geometry import hint_at_geometry, show_geometry
from bcid.recording.checks.limits import AGREEMENT as LIMITS
from bcid.recording.checks.mounting import estimate_yaw_offset
from bcid.recording.checks.plausibility import check_commands
from bcid.recording.checks.pose_verdict import judge_poses
from bcid.recording.checks.steering_verdict import SteeringAgreement, judge_steering
from bcid.recording.checks.throttle_verdict import ThrottleAgreement, exchange_commands, judge_throttle
from bcid.recording.checks.turning import TurningData, prepare_turning
from bcid.recording.types import Action, Irregularity, Recording, command_source_path
from bcid.vehicle import Vehicle

FOREIGN = "other commands"
"""The kind of the verdict on commands that fit at no offset."""


def refuse(recording: Recording, kind: str, text: str, action: Action = "no-go") -> Recording:
    """The recording with one irregularity more of its `kind`, whose `text` names cause and next step."""
    source = recording.sources[0].path if kind == "poses" else command_source_path(recording.sources)
    return replace(recording, irregularities=(*recording.irregularities, Irregularity(kind, action, 1, source, text)))


def compare_commands(
    recording: Recording, data: TurningData, vehicle: Vehicle
) -> tuple[SteeringAgreement, ThrottleAgreement]:
    """How steering and throttle commands agree with the motion, with a verdict of each where they do not."""
    motion = compare_on_grid(recording, data, vehicle)
    steering = judge_steering(motion, recording, vehicle)
    lag_s = steering.lag_s if steering.agrees or steering.share > LIMITS.least_share else None
    throttle = judge_throttle(motion, vehicle, lag_s)
    if steering.verdict is not None and not steering.agrees and steering.fault is None:
        exchanged = replace(recording, commands=replace(
            recording.commands, values=recording.commands.values[:, ::-1]
        ))  # fmt: skip
        other = judge_steering(exchange_commands(motion), exchanged, vehicle)
        if other.agrees:
            text = "steering and throttle are swapped: the throttle explains the turning; exchange their columns"
            return steering._replace(verdict=text, foreign=False), throttle._replace(verdict=None)
    return steering, throttle


def raise_likely_cause(recording: Recording, vehicle: Vehicle) -> None:
    """Raise `InputRefused` where commands beyond the car's limits fit its motion once they are read in another way.

    Nothing is raised where no exchange or change of sign is within the limits and explains turning and acceleration.
    """
    data, source = prepare_turning(recording, vehicle), command_source_path(recording.sources)
    if data is None:
        return
    u = recording.commands.values
    readings = (
        (
            "steering_rad, throttle_mps",
            "are swapped: exchanged, they explain",
            "exchange their columns or topics",
            u[:, ::-1],
        ),
        ("throttle_mps", "has the other sign: turned round, it explains", "map it with gain = -1", u * [1.0, -1.0]),
    )
    for place, cause, step, values in readings:
        commands = replace(recording.commands, values=np.ascontiguousarray(values))
        other = replace(recording, commands=commands)
        try:
            check_commands(values, vehicle, source)
        except InputRefused:
            continue
        steering, throttle = compare_commands(other, data, vehicle)
        fits = steering.verdict is None and throttle.verdict is None and throttle.share > LIMITS.foreign_throttle_share
        if fits and throttle.follows and steering.share > LIMITS.least_share:
            shares = f"{steering.share:.0%} of the turning and {throttle.share:.0%} of the acceleration"
            raise InputRefused(source, place, f"{cause} {shares}", step)


def _judge_mounting(recording: Recording, vehicle: Vehicle) -> str | None:
    """The verdict on a body that is turned so far on its car that no command could be judged; None on others."""
    offset = estimate_yaw_offset(recording, vehicle)
    if offset is None or abs(offset.rad) < LIMITS.turned_body_rad:
        return None
    value = float(np.angle(np.exp(1j * ((vehicle.mocap.yaw_offset_rad or 0.0) + offset.rad))))
    return (
        f"the tracked body points {offset.rad:.2f} rad off the way that the car goes, so that no command can be "
        f"judged; set mocap.yaw_offset_rad = {value:.3f}, or turn the body in the tracking system"
    )


def judge_recording(recording: Recording, vehicle: Vehicle) -> tuple[Recording, TurningData | None, float | None]:
    """The recording with a verdict where it cannot be used; its turning, and the lag (s) at which its commands fit.

    The lag is that of the steering commands against the motion, the servo apart; None where they fit at none.
    """
    noise = judge_poses(recording, vehicle)
    if noise is not None:
        return refuse(recording, "poses", noise), None, None
    data = prepare_turning(recording, vehicle)
    if data is None:
        return recording, None, None
    steering, throttle = compare_commands(recording, data, vehicle)
    if steering.judged or steering.verdict is not None:
        # a coarser judgement of what has been judged here
        others = tuple(i for i in recording.irregularities if i.kind != "steering response")
        recording = replace(recording, irregularities=others)
    turned = _judge_mounting(recording, vehicle) if steering.verdict is not None and steering.fault is None else None
    if turned is not None:
        return refuse(recording, "poses", turned), data, None
    if steering.verdict is not None:
        if steering.fault is not None:
            action: Action = "warning" if steering.fault.is_usable else "no-go"
            return refuse(recording, steering.fault.kind, steering.verdict, action), data, None
        return refuse(recording, FOREIGN if steering.foreign else "steering", steering.verdict), data, None
    if steering.judged and steering.share < LIMITS.least_share:
        text = f"the steering commands explain {steering.share:.0%} of the turning: another take's, or a slipping car?"
        recording = refuse(recording, "steering", text, "warning")
    # a yaw that is off makes every length wrong, and a scale all that is said of lengths and speeds
    askew = any(i.kind in ("yaw offset", "scale") for i in recording.irregularities)
    fits = steering.share > LIMITS.least_share and not askew
    shown = show_geometry(data, vehicle, steering.lag_s, steering.servo) if fits else None
    hint = hint_at_geometry(shown, vehicle) if shown is not None else None
    if hint is not None:
        recording = refuse(recording, "vehicle file", hint, "warning")
    misread = hint is not None or askew
    # the speed of the front axle is wrong by a wrong lever or scale: the throttle may be right
    if throttle.verdict is not None:
        recording = refuse(recording, "throttle", throttle.verdict, "warning" if misread else "no-go")
    elif throttle.warning is not None and not misread:
        recording = refuse(recording, "throttle", throttle.warning, "warning")
    if steering.share <= LIMITS.least_share or not steering.judged:
        return recording, data, None
    # gaps of the commands lie elsewhere once these act later
    return recording, prepare_turning(recording, vehicle, steering.lag_s), steering.lag_s

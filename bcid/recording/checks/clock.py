"""Offset and drift of the command clock against the pose clock, estimated and reported, never applied.

Before, commands lose the age that they have when they are read, where the vehicle file says so (`command_age`).

A servo's lag and a late clock look much alike, so the delay of the commands is fitted together with a servo that the
vehicle file does not state, and with tyres and inertia.  Where no fit can tell delay and servo apart, their sum is
told.
"""

from dataclasses import replace

import numpy as np

from bcid.documents.health import ClockEstimate
from bcid.recording.checks.block_delays import block_delays
from bcid.recording.checks.clock_drift import DRIFT
from bcid.recording.checks.clock_fault import CLOCK_FAULTS
from bcid.recording.checks.command_age import AGE, account_for_age, take_off_mean_age
from bcid.recording.checks.geometry import hint_at_drive
from bcid.recording.checks.limits import CLOCK as LIMITS
from bcid.recording.checks.steering_fit import SteeringFit, fit_steering, systematic_delay_s
from bcid.recording.checks.turning import TurningData, liveliest
from bcid.recording.types import Irregularity, Recording, command_source_path
from bcid.vehicle import Vehicle


def estimate_clock(recording: Recording, vehicle: Vehicle, data: TurningData | None, lag_s: float | None) -> Recording:
    """The recording with an estimate of its clock offset and drift, and what is to be said of a sure one.

    An offset whose whole 95 % interval lies beyond `CLOCK.max_offset_s`, and without which the turning is explained
    clearly worse, is warned of; beyond `CLOCK.max_usable_s` the take cannot be used.

    Args:
        recording: poses and commands.
        vehicle: the car; its file may state the servo and an offset that is applied already.
        data: the recording's turning; None where it is too short.
        lag_s: the lag (s) at which the commands fit the motion; None where they fit at none.
    """
    applied_s = vehicle.clock.offset_s
    if data is None:
        clock = ClockEstimate(applied_s=applied_s, reason="the take is too short")
        return replace(take_off_mean_age(recording, vehicle), clock=clock)
    if lag_s is None:
        moves = any(odd.kind in CLOCK_FAULTS for odd in recording.irregularities)
        reason = "one of the clocks jumps or drifts" if moves else "the commands explain too little of the turning"
        clock = ClockEstimate(applied_s=applied_s, reason=reason)
        return replace(take_off_mean_age(recording, vehicle), clock=clock)
    given = vehicle.steering
    stated = {"T_s": given.time_constant_s, "d": given.max_rate_radps}
    fixed = {name: value for name, value in stated.items() if value is not None}
    fit = fit_steering([liveliest(data, LIMITS.fitted_s)], vehicle, fixed, lag_s)
    recording, data, fit = account_for_age(recording, data, vehicle, fit, fixed)
    part = liveliest(data, LIMITS.fitted_s)
    # a body that sits askew, axles elsewhere or another scale look like an offset, or another drive
    misread = any(odd.kind in ("yaw offset", "vehicle file", "scale") for odd in recording.irregularities)
    hint = None if misread else hint_at_drive(part, vehicle, fit)
    if hint is not None:
        odd = Irregularity("vehicle file", "warning", 1, recording.sources[0].path, hint)
        clock = ClockEstimate(applied_s=applied_s, reason="the driven axle is likely another than stated")
        return replace(recording, clock=clock, irregularities=(*recording.irregularities, odd))
    clock = _estimate(data, vehicle, fit, "T_s" in fixed, applied_s)
    # an age that is not taken off is a drift and an offset, too
    misread = misread or any(odd.kind == AGE and odd.action == "warning" for odd in recording.irregularities)
    said = [odd for odd in _say(clock, recording, vehicle) if odd.action == "no-go" or not misread]
    if any(odd.kind == "clock offset" for odd in said):
        exact = fit_steering([part], vehicle, {**fixed, "delay_s": 0.0})
        told = fit.misfit * float(np.log((exact.scale / fit.scale) ** 2)) > LIMITS.offset_nats
        said = said if told else []
    return replace(recording, clock=clock, irregularities=(*recording.irregularities, *said))


def _estimate(
    data: TurningData, vehicle: Vehicle, fit: SteeringFit, servo_known: bool, applied_s: float
) -> ClockEstimate:  # fmt: skip
    """Offset (s) and drift of the command clock, or the reason for none, by the `fit` of servo and delay."""
    clock = ClockEstimate(applied_s=applied_s, explained=max(fit.explained, 0.0))
    if fit.explained < LIMITS.min_explained_share:
        reason = f"the commands explain only {fit.explained:.0%} of the yaw rate"
        return clock.model_copy(update={"reason": reason})
    blocks = block_delays(data, vehicle, fit, LIMITS.block_s, LIMITS.min_block_share)
    sd = float(np.hypot(fit.sd("delay_s"), systematic_delay_s(data, fit.value("T_s"), servo_known)))
    if sd > LIMITS.max_sd_s:
        lag, lag_sd = fit.lag()
        reason = (
            f"the turning does not tell it from the servo's lag: together {lag - 2 * lag_sd:.2f} to "
            f"{lag + 2 * lag_sd:.2f} s; state steering.time_constant_s"
        )
        return clock.model_copy(update={"reason": reason})
    offset_s = fit.value("delay_s")
    drift = low = high = None
    if len(blocks.delay_s) >= LIMITS.min_blocks:
        from scipy.stats import theilslopes

        drift, _, low, high = (float(x) for x in theilslopes(blocks.delay_s, blocks.middle_s))
        # blocks that the fit has not seen may say otherwise
        sd = float(np.hypot(sd, 0.5 * (np.median(blocks.delay_s) - offset_s)))
    return clock.model_copy(update={
        "offset_s": offset_s, "offset_ci95": (offset_s - 1.96 * sd, offset_s + 1.96 * sd), "drift": drift,
        "drift_ci95": None if low is None or high is None else (low, high), "blocks": len(blocks.delay_s),
    })  # fmt: skip


def _say(clock: ClockEstimate, recording: Recording, vehicle: Vehicle) -> list[Irregularity]:
    """What is to be said of a clock estimate: a warning of a sure offset or drift, or that the take cannot be used."""
    if clock.offset_s is None or clock.offset_ci95 is None:
        return []
    source = command_source_path(recording.sources)
    low, high = clock.offset_ci95
    # a steering whose servo is not known may have a dead time, which looks as if the commands came early
    room = 0.0 if vehicle.steering.time_constant_s is not None else LIMITS.longest_dead_time_s
    said = list[Irregularity]()
    if low > LIMITS.max_offset_s + room or high < -LIMITS.max_offset_s:
        useless = low > LIMITS.max_usable_s + room or high < -LIMITS.max_usable_s
        value = clock.applied_s + clock.offset_s
        sign = "; the sign of offset_s is likely wrong" if _is_opposite(clock) else ""
        when = f"the commands are {_interval(low, high)}, by another clock{sign}"
        text = f"{when}; [clock] offset_s = {value:.3f}, or one clock"
        said.append(Irregularity("clock offset", "no-go" if useless else "warning", 1, source, text))
    if clock.drift_ci95 is not None and not said:
        by_the_end = sorted(recording.duration_s * x for x in clock.drift_ci95)
        if by_the_end[0] > LIMITS.max_drift_s or by_the_end[1] < -LIMITS.max_drift_s:
            text = f"the commands' clock drifts: by the end they are another {_interval(*by_the_end)}; use one clock"
            said.append(Irregularity(DRIFT, "warning", 1, source, text))
    return said


def _is_opposite(clock: ClockEstimate) -> bool:
    """Whether the stated offset would fit with the other sign."""
    low, high = clock.offset_ci95 or (0.0, 0.0)
    return clock.applied_s != 0.0 and low <= -2.0 * clock.applied_s <= high


def _interval(low: float, high: float) -> str:
    """An interval of offsets (s) on one side of zero in words: "12 to 66 ms late", "2.9 to 3.1 s early"."""
    near, far = sorted((abs(low), abs(high)))
    unit = f"{1e3 * near:.0f} to {1e3 * far:.0f} ms" if far < 1.0 else f"{near:.2f} to {far:.2f} s"
    return f"{unit} {'early' if high > 0.0 else 'late'}"

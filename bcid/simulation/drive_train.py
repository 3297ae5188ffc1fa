"""What motor and brake ask of a driven wheel: a speed controller's or a throttle's force, with all that it may lack."""

import math

from bcid.compiled.njit import njit
from bcid.simulation.car import Plant
from bcid.simulation.other_laws import throttle_gate

RIPPLE_MPS = 0.04  # of speed per radian
DROPOUT_PERIOD_S, DROPOUT_S = 7.3, 0.6
HEATING_S = 8.0  # in which heat comes and goes
HOT_SHARE = 0.3  # of the motor's largest force, or of the whole brake at 1 m/s: what heats up to 1 in the long run
LEAST_SHARE = 0.1  # of its force that is left to a hot motor or brake


@njit
def _supplied_force(command: float, rolling: float, p: Plant) -> tuple[float, float]:
    """Force (N) of motor and controller under the throttle `command` >= 0, and how far its reference is ahead (m/s).

    With `throttle_force` the throttle is a share and sets a force that fades with the `rolling` speed (m/s); there is
    no reference then, and none is behind.  Else the throttle is a reference speed (m/s) up to which the motor supplies.
    """
    if p.throttle_force > 0.0:
        open_share, gate = command - p.motor_dead_zone, 1.0
        if p.zone_steepness > 0.0:
            gate = throttle_gate(command, p.motor_dead_zone, p.zone_steepness)
        elif open_share <= 0.0:
            return 0.0, 0.0
        pull = p.throttle_force * open_share - p.motor_fade * rolling
        pull = max(-p.motor_limit, min(p.motor_limit, pull))
        return gate * (pull - p.pulsed_fade * open_share * rolling), 0.0
    lack = max(command - p.motor_dead_zone, 0.0) - rolling
    return min(p.motor_gain * lack, p.motor_limit) if lack > 0.0 else 0.0, lack


@njit
def requested_motor_force(command: float, rolling: float, time: float, duration: float, heat: float, p: Plant) -> float:
    """Motor force (N) before its lag under the throttle `command`, at the wheel's `rolling` speed (m/s).

    `command` >= 0 is a reference speed (m/s) up to which the motor supplies, or with `throttle_force` a share of full
    throttle; below 0 it is a brake share, or with `reverses` what drives backward.  `time` (s) of the `duration` (s)
    counts where the battery runs down or the motor drops out, `heat` where motor or brake give way when they are hot.
    """
    way = 1.0
    if command < 0.0 and p.reverses > 0.0:
        way, command, rolling = -1.0, -command, -rolling
    if command < 0.0:
        brake = max(-p.motor_limit, min(p.motor_limit, command * p.brake_gain * rolling))
        return brake * max(1.0 - p.brake_fading * heat, LEAST_SHARE) if p.brake_fading > 0.0 else brake
    force, lack = _supplied_force(command, rolling, p)
    if p.inverse_power_limit > 0.0:
        force = min(force, 1.0 / (p.inverse_power_limit * max(abs(rolling), 0.2)))
    force *= 1.0 - p.motor_sag * time / duration
    force *= 1.0 + p.motor_ripple * math.sin(rolling / RIPPLE_MPS)
    if time % DROPOUT_PERIOD_S < DROPOUT_S:
        force *= 1.0 - p.motor_dropout
    if p.motor_heating > 0.0:
        force *= max(1.0 - p.motor_heating * heat, LEAST_SHARE)
    if lack < 0.0 and p.motor_regeneration > 0.0:
        force = max(p.motor_regeneration * p.motor_gain * lack, -p.motor_limit)
    return way * force


@njit
def heating_rate(heat: float, force: float, p: Plant) -> float:
    """Rate (1/s) at which the `heat` of what may fade grows under the motor's or brake's `force` (N).

    The motor is heated by what it pulls, the brake by what it holds back; without either effect nothing is heated.
    """
    source = 0.0
    if p.motor_heating > 0.0 and force > 0.0:
        source = (force / (HOT_SHARE * p.motor_limit)) ** 2
    if p.brake_fading > 0.0 and force < 0.0:
        source = (force / (HOT_SHARE * p.brake_gain)) ** 2
    return (source - heat) / HEATING_S

"""Servo, linkage and wheels: the front wheel's angle, and the forces of all tyres from their contact velocities."""

import math
from typing import NamedTuple

from bcid.compiled.njit import njit
from bcid.simulation.car import Plant
from bcid.simulation.drive_train import requested_motor_force
from bcid.simulation.other_laws import dry_steered_drag, magic_side_force, regularised_speed, two_sided_angle

UNEVENNESS_M = 0.5  # of way per radian


class PlantInputs(NamedTuple):
    """What acts during one fine step."""

    time: float
    duration: float  # of the whole take, s
    steer: float  # command after its delay
    drive: float
    push_x: float  # the floor's random force, body frame
    push_y: float
    push_turn: float


class FrontHub(NamedTuple):
    """What the front wheel's hub meets, body frame."""

    along: float
    across: float
    lagged_slip: float
    lagged_force: float
    rolled: float  # m
    rough: bool  # on the rough patch
    slippery: float  # share of the grip that is there
    soft: float
    stiff: float  # share of the cornering stiffness that is there
    heat: float  # of motor and brake
    rear_pull: float  # N along the body, of a driven rear axle


@njit
def _slip_divisor(rolling: float, p: Plant) -> float:
    """Speed (m/s) by which the slide of a wheel that rolls at `rolling` (m/s) is divided in its slip angle."""
    if p.slip_fade > 0.0:
        return regularised_speed(rolling, p.slip_speed, p.slip_fade)
    return max(abs(rolling), p.slip_speed)


@njit
def _tyre_side_force(
    slip: float, stiffness: float, grip: float, shift: float, soft: float, magic: float, p: Plant
) -> float:
    """Side force (N) of a tyre at the slip angle `slip` (rad): shift - stiffness slip, limited by `grip` (N).

    `soft`, from 0 to 1, blends a hard limit with tanh, past which the share `tyre_fall` of the grip is lost; with a
    shape factor `magic` above zero the limit is Pacejka's formula instead.
    """
    linear, fall = shift - stiffness * slip, p.tyre_fall
    if grip <= 0.0:
        return 0.0
    if magic > 0.0:
        return magic_side_force(linear, grip, magic, p.magic_curvature)
    over = max(abs(linear) / grip - 1.0, 0.0)
    grip_there = grip * (1.0 - fall * (1.0 - math.exp(-over)))
    hard = max(-grip_there, min(grip_there, linear))
    if soft == 0.0:
        return hard
    return (1.0 - soft) * hard + soft * grip_there * math.tanh(linear / grip)


@njit
def servo_rate(miss: float, p: Plant) -> float:
    """Rate (rad/s) of a servo whose command is `miss` (rad) ahead: first order with a dead band and rate limits."""
    if abs(miss) < p.steering_dead_band:
        return 0.0
    skew = p.steering_rate_asymmetry
    return max(-p.servo_rate * (1.0 - skew), min(p.servo_rate * (1.0 + skew), miss / p.servo_time))


@njit
def linkage_angle(servo: float, lagged: float, play: float, speed: float, p: Plant) -> float:
    """Angle (rad) of the front wheel behind servo, lag, play and the linkage's nonlinearity, without compliance.

    `servo` and `lagged` are the angles (rad) before and behind the lag, `play` the angle that the play left behind
    it, `speed` (m/s) the car's.
    """
    angle = lagged if p.steering_lag > 0.0 else servo
    if p.steering_backlash > 0.0:
        angle = max(angle - p.steering_backlash, min(angle + p.steering_backlash, play))
    if p.left_reach > 0.0 and p.right_reach > 0.0:
        angle = two_sided_angle(angle, p.linkage_centre, p.left_reach, p.right_reach)
    angle += p.steering_nonlinearity * angle**3
    if angle != 0.0:
        angle *= 1.0 + p.steering_side_gain * math.copysign(1.0, angle)
    return angle * (1.0 - p.steering_speed_gain * speed) + p.steering_offset


@njit
def rolling_resistance(rolling: float, p: Plant) -> float:
    """Drag (N) of the driven wheels together at their `rolling` speed (m/s)."""
    return p.rolling_drag * rolling + p.rolling_drag_2 * rolling * abs(rolling)


@njit
def evaluate_front_wheel(
    angle: float, hub: FrontHub, i: PlantInputs, p: Plant
) -> tuple[float, float, float, float, float]:
    """Rolling speed (m/s), steady slip angle (rad), motor force before its lag, force along and across the wheel (N).

    `angle` (rad) is the wheel's angle to the body.  Of motor force and rolling drag the wheel has the share that the
    rear axle leaves to it; what resists a steered wheel is its own.
    """
    roll = math.cos(angle) * hub.along + math.sin(angle) * hub.across
    slide = math.cos(angle) * hub.across - math.sin(angle) * hub.along
    steady_slip = math.atan(slide / _slip_divisor(roll, p))
    slip = hub.lagged_slip if p.tyre_relaxation > 0.0 else steady_slip
    wanted = requested_motor_force(i.drive, roll, i.time, i.duration, hub.heat, p)
    share = 1.0 - p.rear_drive
    force = share * (hub.lagged_force if p.motor_lag > 0.0 else wanted)
    resist = share * rolling_resistance(roll, p) + p.steering_drag * abs(angle) * roll
    if p.dry_steered_drag > 0.0:
        resist += dry_steered_drag(angle, roll, p.dry_steered_drag, p.dry_steered_rise)
    resist += (p.front_coulomb_friction + p.steering_friction * abs(angle)) * math.tanh(roll / 0.05)
    if hub.rough:
        resist += p.rough_patch * roll
    resist += p.drive_unevenness * math.sin(hub.rolled / UNEVENNESS_M)
    load = 1.0 - p.load_transfer * (force - resist) * math.cos(angle) / p.mass
    load -= p.load_transfer * hub.rear_pull / p.mass
    grip = p.front_grip * hub.slippery * load
    if p.friction_circle > 0.0 and grip > 0.0:
        grip *= math.sqrt(max(1.0 - p.friction_circle * (force / grip) ** 2, 0.0))
    shift = p.front_ply_steer * math.tanh(roll / 0.05)
    side = _tyre_side_force(slip, p.front_stiffness * hub.stiff * load, grip, shift, hub.soft, p.front_magic, p)
    return roll, steady_slip, wanted, force - resist, side


@njit
def solve_compliant_angle(base: float, hub: FrontHub, i: PlantInputs, p: Plant) -> float:
    """Wheel angle (rad) that the wheel's own side force F(angle) bends: angle = base + k F(angle), by bisection.

    `base` is the angle (rad) without compliance, k the compliance (rad/N) of `p`.
    """
    reach = abs(p.steering_compliance) * 2.0 * p.front_grip
    low, high = base - reach, base + reach
    for _ in range(45):
        middle = 0.5 * (low + high)
        if base + p.steering_compliance * evaluate_front_wheel(middle, hub, i, p)[4] > middle:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@njit
def add_rear_wheel_forces(
    body_x: float, body_y: float, moment: float, along: float, across: float, turn: float, slippery: float,
    soft: float, p: Plant,
) -> tuple[float, float, float]:  # fmt: skip
    """Force x, y (N, body frame) and moment (N m) on the body after adding those of the two rear wheels.

    `along`, `across` (m/s), `turn` (rad/s) are the body-frame twist of the CoG; `slippery` is the share of the grip
    that the floor leaves, `soft` (0 to 1) the softness of the tyres' saturation.
    """
    for hand in (1.0, -1.0):
        offset = 0.5 * hand * p.rear_track
        wheel_along = along - offset * turn
        wheel_across = across - p.rear_lever * turn
        slip = math.atan(wheel_across / _slip_divisor(wheel_along, p))
        slip -= p.rear_toe * wheel_along / max(abs(wheel_along), p.slip_speed) + p.rear_roll_steer * turn * along
        side = 0.5 * _tyre_side_force(slip, p.rear_stiffness, p.rear_grip * slippery, 0.0, soft, p.rear_magic, p)
        resist = 0.5 * (p.rear_bearing * math.tanh(wheel_along / 0.05) + p.rear_rolling * wheel_along)
        body_x -= resist
        body_y += side
        moment += offset * resist - p.rear_lever * side
    return body_x, body_y, moment

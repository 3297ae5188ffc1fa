"""The plant: wheel by wheel, in world coordinates, by RK4 at a fine step.

State: X, Y, heading, world velocity U, V, turn rate, servo angle, lagged wheel angle, motor force,
lagged front slip, way rolled by the driven wheel.  Forces are found at each wheel from its own contact velocity.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant

STEPS_PER_S = 480
MAX_STEPS = 400
STATE_SIZE = 11

UNEVENNESS_M = 0.5  # of way per radian
RIPPLE_MPS = 0.04  # of speed per radian
DROPOUT_PERIOD_S, DROPOUT_S = 7.3, 0.6
SHIMMY_RADPS = 5.7
WAVES_M = 0.65  # of floor per radian


class PlantInputs(NamedTuple):
    """What acts during one fine step."""

    time: float
    duration: float  # of the whole take, s
    steer: float  # command after its delay
    drive: float
    push_x: float  # the floor's random force, body frame
    push_y: float
    push_turn: float


@njit
def _tyre_side_force(slip: float, stiffness: float, grip: float, shift: float, soft: float, fall: float) -> float:
    """Side force (N) of a tyre at the slip angle `slip` (rad): shift - stiffness slip, limited by `grip` (N).

    `soft`, from 0 to 1, blends a hard limit with tanh; `fall` is the share of the grip that is lost far past
    saturation.
    """
    linear = shift - stiffness * slip
    if grip <= 0.0:
        return 0.0
    over = max(abs(linear) / grip - 1.0, 0.0)
    grip_there = grip * (1.0 - fall * (1.0 - math.exp(-over)))
    hard = max(-grip_there, min(grip_there, linear))
    if soft == 0.0:
        return hard
    return (1.0 - soft) * hard + soft * grip_there * math.tanh(linear / grip)


@njit
def _requested_motor_force(command: float, rolling: float, time: float, duration: float, p: Plant) -> float:
    """Motor force (N) before its lag under the throttle `command`, at the wheel's `rolling` speed (m/s).

    `command` >= 0 is a reference speed (m/s) up to which the motor supplies, or with `throttle_force` a share of full
    throttle; below 0 it is a brake share, or with `reverses` what drives backward.  `time` (s) of
    the `duration` (s) counts where the battery runs down or the motor drops out.
    """
    way = 1.0
    if command < 0.0 and p.reverses > 0.0:
        way, command, rolling = -1.0, -command, -rolling
    if command < 0.0:
        return max(-p.motor_limit, min(p.motor_limit, command * p.brake_gain * rolling))
    if p.throttle_force > 0.0:
        if command <= p.motor_dead_zone:
            return 0.0
        pull = p.throttle_force * (command - p.motor_dead_zone) - p.motor_fade * rolling
        return way * max(-p.motor_limit, min(p.motor_limit, pull))
    lack = max(command - p.motor_dead_zone, 0.0) - rolling
    force = min(p.motor_gain * lack, p.motor_limit) if lack > 0.0 else 0.0
    if p.inverse_power_limit > 0.0:
        force = min(force, 1.0 / (p.inverse_power_limit * max(abs(rolling), 0.2)))
    force *= 1.0 - p.motor_sag * time / duration
    force *= 1.0 + p.motor_ripple * math.sin(rolling / RIPPLE_MPS)
    if time % DROPOUT_PERIOD_S < DROPOUT_S:
        force *= 1.0 - p.motor_dropout
    if lack < 0.0 and p.motor_regeneration > 0.0:
        force = max(p.motor_regeneration * p.motor_gain * lack, -p.motor_limit)
    return way * force


@njit
def _is_in_circle(x: float, y: float, centre_x: float, centre_y: float, radius: float) -> bool:
    """Whether the point (x, y) lies within `radius` of the centre, all in m."""
    return (x - centre_x) ** 2 + (y - centre_y) ** 2 < radius * radius


@njit
def _linkage_angle(servo: float, lagged: float, play: float, speed: float, p: Plant) -> float:
    """Angle (rad) of the front wheel behind servo, lag, play and the linkage's nonlinearity, without compliance.

    `servo` and `lagged` are the angles (rad) before and behind the lag, `play` the angle that the play left behind
    it, `speed` (m/s) the car's.
    """
    angle = lagged if p.steering_lag > 0.0 else servo
    if p.steering_backlash > 0.0:
        angle = max(angle - p.steering_backlash, min(angle + p.steering_backlash, play))
    angle += p.steering_nonlinearity * angle**3
    if angle != 0.0:
        angle *= 1.0 + p.steering_side_gain * math.copysign(1.0, angle)
    return angle * (1.0 - p.steering_speed_gain * speed) + p.steering_offset


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


@njit
def _evaluate_front_wheel(
    angle: float, hub: FrontHub, i: PlantInputs, p: Plant
) -> tuple[float, float, float, float, float]:
    """Rolling speed (m/s), steady slip angle (rad), motor force before its lag, force along and across the wheel (N).

    `angle` (rad) is the wheel's angle to the body.
    """
    roll = math.cos(angle) * hub.along + math.sin(angle) * hub.across
    slide = math.cos(angle) * hub.across - math.sin(angle) * hub.along
    steady_slip = math.atan(slide / max(abs(roll), p.slip_speed))
    slip = hub.lagged_slip if p.tyre_relaxation > 0.0 else steady_slip
    driven = (1.0 - p.rear_drive) * roll + p.rear_drive * hub.along
    wanted = _requested_motor_force(i.drive, driven, i.time, i.duration, p)
    force = hub.lagged_force if p.motor_lag > 0.0 else wanted
    resist = p.rolling_drag * roll + p.rolling_drag_2 * roll * abs(roll) + p.steering_drag * abs(angle) * roll
    resist += p.front_coulomb_friction * math.tanh(roll / 0.05)
    if hub.rough:
        resist += p.rough_patch * roll
    resist += p.drive_unevenness * math.sin(hub.rolled / UNEVENNESS_M)
    load = 1.0 - p.load_transfer * (force - resist) * math.cos(angle) / p.mass
    grip = p.front_grip * hub.slippery * load
    if p.friction_circle > 0.0 and grip > 0.0:
        grip *= math.sqrt(max(1.0 - p.friction_circle * (force / grip) ** 2, 0.0))
    shift = p.front_ply_steer * math.tanh(roll / 0.05)
    side = _tyre_side_force(slip, p.front_stiffness * load, grip, shift, hub.soft, p.tyre_fall)
    return roll, steady_slip, wanted, force - resist, side


@njit
def _solve_compliant_angle(base: float, hub: FrontHub, i: PlantInputs, p: Plant) -> float:
    """Wheel angle (rad) that the wheel's own side force F(angle) bends: angle = base + k F(angle), by bisection.

    `base` is the angle (rad) without compliance, k the compliance (rad/N) of `p`.
    """
    reach = abs(p.steering_compliance) * 2.0 * p.front_grip
    low, high = base - reach, base + reach
    for _ in range(45):
        middle = 0.5 * (low + high)
        if base + p.steering_compliance * _evaluate_front_wheel(middle, hub, i, p)[4] > middle:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@njit
def _add_rear_wheel_forces(
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
        slip = math.atan(wheel_across / max(abs(wheel_along), p.slip_speed))
        slip -= p.rear_toe * wheel_along / max(abs(wheel_along), p.slip_speed) + p.rear_roll_steer * turn * along
        side = 0.5 * _tyre_side_force(slip, p.rear_stiffness, p.rear_grip * slippery, 0.0, soft, p.tyre_fall)
        resist = 0.5 * (p.rear_bearing * math.tanh(wheel_along / 0.05) + p.rear_rolling * wheel_along)
        body_x -= resist
        body_y += side
        moment += offset * resist - p.rear_lever * side
    return body_x, body_y, moment


@njit
def _add_resistances(
    body_x: float, body_y: float, moment: float, along: float, across: float, turn: float, p: Plant
) -> tuple[float, float, float]:
    """Body force (N) and moment (N m) with rolling, air and yaw friction added, at twist (along, across, turn)."""
    body_x -= p.rear_rolling_coulomb * math.tanh(along / 0.05) + p.rear_rolling_viscous * along
    if p.rear_drag_asymmetry != 0.0:
        offset = math.copysign(0.5 * p.asymmetry_track, p.rear_drag_asymmetry)
        resist = abs(p.rear_drag_asymmetry) * (along - offset * turn)
        body_x -= resist
        moment += offset * resist
    speed = math.hypot(along, across)
    body_x -= p.quadratic_drag * speed * along
    body_y -= p.quadratic_drag * speed * across
    moment -= p.yaw_scrub * turn + p.yaw_coulomb * math.tanh(turn / 0.05)
    return body_x, body_y, moment


@njit
def _servo_rate(miss: float, p: Plant) -> float:
    """Rate (rad/s) of a servo whose command is `miss` (rad) ahead: first order with a dead band and rate limits."""
    if abs(miss) < p.steering_dead_band:
        return 0.0
    skew = p.steering_rate_asymmetry
    return max(-p.servo_rate * (1.0 - skew), min(p.servo_rate * (1.0 + skew), miss / p.servo_time))


@njit
def state_derivative(s: Floats, play: float, i: PlantInputs, p: Plant) -> Floats:
    """Time derivative (STATE_SIZE,) of the simulated car's state `s`, with all its extras and concealed effects.

    `s` holds x, y (m), heading, world velocity, yaw rate, angles of servo and wheel, motor force, slip angle, way
    rolled.  `play` is the wheel angle (rad) that the play in the steering left at the last step, `i` what acts from
    outside.
    """
    heading, turn = s[2], s[5]
    cos_h, sin_h = math.cos(heading), math.sin(heading)
    along = cos_h * s[3] + sin_h * s[4]
    across = cos_h * s[4] - sin_h * s[3]
    slippery = 1.0
    if _is_in_circle(s[0], s[1], p.slippery_patch_x, p.slippery_patch_y, p.slippery_patch_radius):
        slippery = 1.0 - p.slippery_patch
    rough = p.rough_patch != 0.0 and _is_in_circle(s[0], s[1], p.rough_patch_x, p.rough_patch_y, p.rough_patch_radius)
    soft = 1.0 - (1.0 - p.softness) * (1.0 - p.tyre_soft_saturation)

    slippery *= 1.0 - p.tyre_wear * i.time / i.duration
    hub = FrontHub(along, across + p.front_lever * turn, s[9], s[8], s[10], rough, slippery, soft)
    angle = _linkage_angle(s[6], s[7], play, math.hypot(s[3], s[4]), p)
    angle += p.steering_shimmy * math.sin(SHIMMY_RADPS * i.time)
    if p.steering_compliance != 0.0:
        angle = _solve_compliant_angle(angle, hub, i, p)
    roll, steady_slip, wanted, pull, side = _evaluate_front_wheel(angle, hub, i, p)
    front_pull = (1.0 - p.rear_drive) * pull
    front_x = math.cos(angle) * front_pull - math.sin(angle) * side
    front_y = math.sin(angle) * front_pull + math.cos(angle) * side
    body_x, body_y, moment = front_x, front_y, p.front_lever * front_y
    body_x += p.rear_drive * pull
    moment += p.drive_lateral_offset * pull * math.cos(angle)

    body_x, body_y, moment = _add_rear_wheel_forces(body_x, body_y, moment, along, across, turn, slippery, soft, p)
    body_x, body_y, moment = _add_resistances(body_x, body_y, moment, along, across, turn, p)
    servo = _servo_rate(i.steer - s[6], p)
    moment -= p.steering_reaction * servo
    body_x, body_y, moment = body_x + i.push_x, body_y + i.push_y, moment + i.push_turn
    world_x, world_y = cos_h * body_x - sin_h * body_y, sin_h * body_x + cos_h * body_y
    if p.tether_pull != 0.0:
        gap_x, gap_y = p.tether_x - s[0], p.tether_y - s[1]
        reach = math.hypot(gap_x, gap_y)
        if reach > p.tether_slack and reach > 0.0:
            world_x += p.tether_pull * (reach - p.tether_slack) * gap_x / reach
            world_y += p.tether_pull * (reach - p.tether_slack) * gap_y / reach
    world_x += p.washboard * math.sin(s[0] / WAVES_M)
    heavier = 1.0 + p.mass_change if i.time >= p.mass_change_at else 1.0

    out = np.empty(STATE_SIZE)
    out[0], out[1], out[2] = s[3], s[4], turn
    out[3] = world_x / (heavier * p.mass) + p.floor_slope_x
    out[4] = world_y / (heavier * p.mass) + p.floor_slope_y
    out[5] = moment / (heavier * p.inertia)
    out[6] = servo
    out[7] = (s[6] - s[7]) / p.steering_lag if p.steering_lag > 0.0 else 0.0
    out[8] = (wanted - s[8]) / p.motor_lag if p.motor_lag > 0.0 else 0.0
    out[9] = abs(roll) * (steady_slip - s[9]) / p.tyre_relaxation if p.tyre_relaxation > 0.0 else 0.0
    out[10] = roll
    return out


@njit
def advance_plant(s: Floats, play: float, i: PlantInputs, length: float, p: Plant) -> tuple[Floats, float]:
    """Plant state (STATE_SIZE,) and angle behind the steering's play (rad) after `length` seconds, by RK4.

    `length` is at most 1/STEPS_PER_S; short lags of steering, motor or tyre divide it into up to MAX_STEPS steps.
    """
    fastest = 1.0
    if p.steering_lag > 0.0:
        fastest = max(fastest, 1.0 / p.steering_lag)
    if p.motor_lag > 0.0:
        fastest = max(fastest, 1.0 / p.motor_lag)
    if p.tyre_relaxation > 0.0:
        fastest = max(fastest, (math.hypot(s[3], s[4]) + p.front_lever * abs(s[5])) / p.tyre_relaxation)
    steps = min(MAX_STEPS, math.ceil(fastest / STEPS_PER_S))
    h = length / steps
    for _ in range(steps):
        k1 = state_derivative(s, play, i, p)
        k2 = state_derivative(s + 0.5 * h * k1, play, i, p)
        k3 = state_derivative(s + 0.5 * h * k2, play, i, p)
        k4 = state_derivative(s + h * k3, play, i, p)
        s = s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    angle = s[7] if p.steering_lag > 0.0 else s[6]
    return s, max(angle - p.steering_backlash, min(angle + p.steering_backlash, play))

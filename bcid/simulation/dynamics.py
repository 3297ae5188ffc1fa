"""The plant: wheel by wheel, in world coordinates, by RK4 at a fine step.

State: X, Y, heading, world velocity U, V, turn rate, servo angle, lagged wheel angle, motor force of the front wheel,
lagged front slip, way rolled by the front wheel, motor force of the rear wheels, heat of motor and brake, offset of a
load on springs along and across, its rates, turn rate of a servo of second order.  Forces are found at each wheel from
its own contact velocity.
"""

import math

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant
from bcid.simulation.drive_train import heating_rate, requested_motor_force
from bcid.simulation.other_laws import servo_acceleration
from bcid.simulation.surroundings import (
    add_resistances,
    add_unnamed_forces,
    is_in_circle,
    load_acceleration,
    load_reaction,
    pull_of_place,
    swell,
)
from bcid.simulation.wheels import (
    FrontHub,
    PlantInputs,
    add_rear_wheel_forces,
    evaluate_front_wheel,
    linkage_angle,
    rolling_resistance,
    servo_rate,
    solve_compliant_angle,
)

STEPS_PER_S = 480
MAX_STEPS = 400
STATE_SIZE = 18

SHIMMY_RADPS = 5.7


@njit
def _rear_drive(along: float, lagged: float, heat: float, i: PlantInputs, p: Plant) -> tuple[float, float]:
    """Motor force (N) of driven rear wheels before its lag, and what they pull (N) along the body, drag deducted.

    They roll at `along` (m/s); `lagged` (N) is the force that a motor with a lag has.  The pull is the rear's share.
    """
    if p.rear_drive == 0.0:
        return 0.0, 0.0
    wanted = requested_motor_force(i.drive, along, i.time, i.duration, heat, p)
    force = lagged if p.motor_lag > 0.0 else wanted
    return wanted, p.rear_drive * (force - rolling_resistance(along, p))


@njit
def _grip_left(x: float, y: float, i: PlantInputs, p: Plant) -> float:
    """Share of the tyres' grip that the floor at (x, y) (m) and their wear leave."""
    grip = 1.0
    if is_in_circle(x, y, p.slippery_patch_x, p.slippery_patch_y, p.slippery_patch_radius):
        grip = 1.0 - p.slippery_patch
    return grip * (1.0 - p.tyre_wear * i.time / i.duration)


@njit
def _wheel_angle(s: Floats, play: float, hub: FrontHub, i: PlantInputs, p: Plant) -> float:
    """Angle (rad) of the front wheel in the state `s`, shaken and bent; `play` (rad) as in linkage_angle."""
    angle = linkage_angle(s[6], s[7], play, math.hypot(s[3], s[4]), p)
    angle += p.steering_shimmy * math.sin(SHIMMY_RADPS * i.time)
    if p.steering_creep != 0.0:
        angle += p.steering_creep * swell(i.time, i.duration)
    return solve_compliant_angle(angle, hub, i, p) if p.steering_compliance != 0.0 else angle


@njit
def state_derivative(s: Floats, play: float, i: PlantInputs, p: Plant) -> Floats:
    """Time derivative (STATE_SIZE,) of the simulated car's state `s`, with all its extras and concealed effects.

    What `s` holds stands at the head of this module.  `play` is the wheel angle (rad) that the play in the steering
    left at the last step, `i` what acts from outside.
    """
    heading, turn = s[2], s[5]
    cos_h, sin_h = math.cos(heading), math.sin(heading)
    along = cos_h * s[3] + sin_h * s[4]
    across = cos_h * s[4] - sin_h * s[3]
    rough = p.rough_patch != 0.0 and is_in_circle(s[0], s[1], p.rough_patch_x, p.rough_patch_y, p.rough_patch_radius)
    soft = 1.0 - (1.0 - p.softness) * (1.0 - p.tyre_soft_saturation)
    slippery = _grip_left(s[0], s[1], i, p)
    stiff = 1.0 - p.tyre_warming * swell(i.time, i.duration) if p.tyre_warming != 0.0 else 1.0

    rear_wanted, rear_pull = _rear_drive(along, s[11], s[12], i, p)
    hub = FrontHub(
        along, across + p.front_lever * turn, s[9], s[8], s[10], rough, slippery, soft, stiff, s[12], rear_pull
    )
    angle = _wheel_angle(s, play, hub, i, p)
    roll, steady_slip, wanted, pull, side = evaluate_front_wheel(angle, hub, i, p)
    front_x = math.cos(angle) * pull - math.sin(angle) * side
    front_y = math.sin(angle) * pull + math.cos(angle) * side
    body_x, body_y, moment = front_x, front_y, p.front_lever * front_y
    body_x += rear_pull
    moment += p.drive_lateral_offset * (pull * math.cos(angle) + rear_pull)

    body_x, body_y, moment = add_rear_wheel_forces(body_x, body_y, moment, along, across, turn, slippery, soft, p)
    body_x, body_y, moment = add_resistances(body_x, body_y, moment, along, across, turn, p)
    body_x, body_y, moment = add_unnamed_forces(body_x, body_y, moment, along, heading, s[1], i.time, i.duration, p)
    swings, miss = p.servo_damping > 0.0, i.steer - s[6]
    servo = max(-p.servo_rate, min(p.servo_rate, s[17])) if swings else servo_rate(miss, p)
    moment -= p.steering_reaction * servo
    body_x, body_y, moment = body_x + i.push_x, body_y + i.push_y, moment + i.push_turn
    mass = p.mass
    if p.swinging_load > 0.0:
        body_x, body_y = body_x + load_reaction(s[13], s[15], p), body_y + load_reaction(s[14], s[16], p)
        mass *= 1.0 - p.swinging_load
    place_x, place_y = pull_of_place(s[0], s[1], i.time, p)
    world_x, world_y = cos_h * body_x - sin_h * body_y + place_x, sin_h * body_x + cos_h * body_y + place_y
    heavier = 1.0 + p.mass_change if i.time >= p.mass_change_at else 1.0

    out = np.zeros(STATE_SIZE)
    out[0], out[1], out[2] = s[3], s[4], turn
    out[3] = world_x / (heavier * mass) + p.floor_slope_x
    out[4] = world_y / (heavier * mass) + p.floor_slope_y
    out[5] = moment / (heavier * p.inertia)
    out[6] = servo
    out[7] = (s[6] - s[7]) / p.steering_lag if p.steering_lag > 0.0 else 0.0
    if p.motor_lag > 0.0:
        out[8], out[11] = (wanted - s[8]) / p.motor_lag, (rear_wanted - s[11]) / p.motor_lag
    out[9] = abs(roll) * (steady_slip - s[9]) / p.tyre_relaxation if p.tyre_relaxation > 0.0 else 0.0
    out[10] = roll
    if swings:
        out[17] = servo_acceleration(miss, s[17], p.servo_time, p.servo_damping, p.servo_rate)
    if p.motor_heating > 0.0 or p.brake_fading > 0.0:
        out[12] = heating_rate(s[12], wanted, p)
    if p.swinging_load > 0.0:
        out[13], out[14] = s[15], s[16]
        out[15] = load_acceleration(s[13], s[15], cos_h * out[3] + sin_h * out[4])
        out[16] = load_acceleration(s[14], s[16], cos_h * out[4] - sin_h * out[3])
    return out


@njit
def _fastest_rate(s: Floats, p: Plant) -> float:
    """The highest rate (1/s) at which something in the plant decays in the state `s`: a lag, or a light car's tyres."""
    fastest = 1.0
    if p.steering_lag > 0.0:
        fastest = max(fastest, 1.0 / p.steering_lag)
    if p.motor_lag > 0.0:
        fastest = max(fastest, 1.0 / p.motor_lag)
    if p.servo_damping > 0.0:  # the faster of its two rates, where it is damped beyond ringing
        ringing = 2.0 * p.servo_damping / p.servo_time
        fastest = max(fastest, ringing * (p.servo_damping + math.sqrt(max(p.servo_damping**2 - 1.0, 0.0))), ringing)
    if p.tyre_relaxation > 0.0:
        fastest = max(fastest, (math.hypot(s[3], s[4]) + p.front_lever * abs(s[5])) / p.tyre_relaxation)
    slide = (p.front_stiffness + p.rear_stiffness) / p.mass
    turn = (p.front_stiffness * p.front_lever**2 + p.rear_stiffness * p.rear_lever**2) / p.inertia
    return max(fastest, (slide + turn) / p.slip_speed)


@njit
def advance_plant(s: Floats, play: float, i: PlantInputs, length: float, p: Plant) -> tuple[Floats, float]:
    """Plant state (STATE_SIZE,) and angle behind the steering's play (rad) after `length` seconds, by RK4.

    `length` is at most 1/STEPS_PER_S; short lags of steering, motor or tyre, and stiff tyres of a light car, divide it
    into up to MAX_STEPS steps.
    """
    steps = min(MAX_STEPS, math.ceil(_fastest_rate(s, p) / STEPS_PER_S))
    h = length / steps
    for _ in range(steps):
        k1 = state_derivative(s, play, i, p)
        k2 = state_derivative(s + 0.5 * h * k1, play, i, p)
        k3 = state_derivative(s + 0.5 * h * k2, play, i, p)
        k4 = state_derivative(s + h * k3, play, i, p)
        s = s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    angle = s[7] if p.steering_lag > 0.0 else s[6]
    return s, max(angle - p.steering_backlash, min(angle + p.steering_backlash, play))

"""A tricycle: one steered front wheel that is driven at a given speed, two rear wheels that roll; on its own equations.

State: X, Y, heading, world velocity U, V, turn rate, servo angle, speed of the front wheel's rim.  The drive holds the
rim at its speed whatever the load: what tyre and floor do not follow is slip, and the slip's force moves the tricycle.
A slip is a velocity of the contact patch over the rolling speed; a tyre answers one along and across alike, and both
together with no more than its grip.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit

TRICYCLE_STATE_SIZE = 8
SERVO, RIM = 6, 7  # where servo angle and the rim's speed stand in a state
GRAVITY = 9.81  # m/s^2


class Tricycle(NamedTuple):
    """Constants of a tricycle, SI."""

    mass: float = 200.0
    inertia: float = 80.0
    front_lever: float = 0.9  # from the CoG to the steered wheel
    rear_lever: float = 0.6
    rear_track: float = 0.8
    angle_limit: float = 1.4
    servo_time: float = 0.15
    servo_rate: float = 1.8
    rim_time: float = 0.25  # in which the drive reaches the speed asked for
    rim_acceleration: float = 0.8  # m/s^2, at most
    slip_stiffness: float = 12.0  # force by slip, in wheel loads
    grip: float = 0.7  # largest force, in wheel loads
    slip_speed: float = 1.0  # m/s, below which slips count as at this speed
    rolling_share: float = 0.005  # rolling resistance in wheel loads
    rolling_growth: float = 0.001  # s/m, by which it grows with the speed
    rough_force: float = 0.0  # N, standard deviation of the floor's random force
    rough_moment: float = 0.0  # N m
    steering_offset: float = 0.0  # rad by which the wheel stands further left than the servo

    @property
    def wheelbase(self) -> float:
        """Distance (m) between the front wheel and the rear axle."""
        return self.front_lever + self.rear_lever

    @property
    def rear_weight(self) -> float:
        """Load (N) on both rear wheels together."""
        return self.mass * GRAVITY * self.front_lever / self.wheelbase


class TricycleInputs(NamedTuple):
    """What acts during one fine step."""

    steer: float  # rad, command to the servo
    speed: float  # m/s, asked of the drive
    push_x: float  # the floor's random force, body frame, N
    push_y: float
    push_turn: float  # N m


@njit
def rolling_drag(along: float, load: float, p: Tricycle) -> float:
    """Rolling resistance (N) of a wheel under a `load` (N) at the speed `along` (m/s), against the motion."""
    return load * (p.rolling_share + p.rolling_growth * abs(along)) * math.tanh(along / 0.05)


@njit
def slip_force(
    slide_along: float, slide_across: float, rolling: float, load: float, p: Tricycle
) -> tuple[float, float]:
    """Force (N) along and across a tyre whose contact patch slides at so much (m/s) against the floor.

    The wheel rolls at `rolling` (m/s) under a `load` (N).  The force opposes the slide.
    """
    over = max(abs(rolling), p.slip_speed)
    slip = math.hypot(slide_along, slide_across) / over
    if slip == 0.0:
        return 0.0, 0.0
    share = load * min(p.slip_stiffness * slip, p.grip) / (slip * over)
    return -share * slide_along, -share * slide_across


@njit
def tricycle_derivative(s: Floats, i: TricycleInputs, p: Tricycle) -> Floats:
    """Time derivative (TRICYCLE_STATE_SIZE,) of a tricycle's state `s` (head of this module) under the inputs `i`."""
    cos_h, sin_h, turn = math.cos(s[2]), math.sin(s[2]), s[5]
    along, across = cos_h * s[3] + sin_h * s[4], cos_h * s[4] - sin_h * s[3]
    weight = p.mass * GRAVITY
    front_load = weight * p.rear_lever / (p.front_lever + p.rear_lever)
    rear_load = 0.5 * (weight - front_load)
    angle = s[SERVO] + p.steering_offset
    cos_w, sin_w = math.cos(angle), math.sin(angle)
    hub = across + p.front_lever * turn
    roll, slide = cos_w * along + sin_w * hub, cos_w * hub - sin_w * along
    pull, side = slip_force(roll - s[RIM], slide, s[RIM], front_load, p)
    # the drive holds the rim against its own wheel's resistance, which so never reaches the body
    body_x, body_y = cos_w * pull - sin_w * side + i.push_x, sin_w * pull + cos_w * side + i.push_y
    moment = p.front_lever * (sin_w * pull + cos_w * side) + i.push_turn
    for wheel in range(2):
        out_left = (0.5 - wheel) * p.rear_track
        forward = along - out_left * turn
        _, hold = slip_force(0.0, across - p.rear_lever * turn, forward, rear_load, p)
        drag = rolling_drag(forward, rear_load, p)
        body_x, body_y = body_x - drag, body_y + hold
        moment += out_left * drag - p.rear_lever * hold
    out = np.zeros(TRICYCLE_STATE_SIZE)
    out[0], out[1], out[2] = s[3], s[4], turn
    out[3] = (cos_h * body_x - sin_h * body_y) / p.mass
    out[4] = (sin_h * body_x + cos_h * body_y) / p.mass
    out[5] = moment / p.inertia
    out[SERVO] = max(-p.servo_rate, min(p.servo_rate, (i.steer - s[SERVO]) / p.servo_time))
    out[RIM] = max(-p.rim_acceleration, min(p.rim_acceleration, (i.speed - s[RIM]) / p.rim_time))
    return out


@njit
def advance_tricycle(s: Floats, i: TricycleInputs, h: float, p: Tricycle) -> Floats:
    """The tricycle's state after `h` seconds of constant inputs `i`, by RK4 in steps that its tyres allow."""
    # a tyre slides to rest at about this rate: all loads together on the mass, levers on the inertia
    rate = p.slip_stiffness * GRAVITY / p.slip_speed
    rate *= 1.0 + p.mass * max(p.front_lever, p.rear_lever) ** 2 / p.inertia
    steps = math.ceil(h * rate)
    k = h / steps
    for _ in range(steps):
        k1 = tricycle_derivative(s, i, p)
        k2 = tricycle_derivative(s + 0.5 * k * k1, i, p)
        k3 = tricycle_derivative(s + 0.5 * k * k2, i, p)
        k4 = tricycle_derivative(s + k * k3, i, p)
        s = s + k / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return s


def kinetic_energy(s: Floats, p: Tricycle) -> float:
    """Kinetic energy (J) of the body in the state `s`."""
    return float(0.5 * p.mass * (s[3] ** 2 + s[4] ** 2) + 0.5 * p.inertia * s[5] ** 2)


def draw_tricycle(rng: np.random.Generator) -> Tricycle:
    """Draw a tricycle of about 1.5 m: mass, levers, servo with a lock of 60 to 90 degrees, drive and tyres."""
    wheelbase, mass = rng.uniform(1.35, 1.65), rng.uniform(100.0, 300.0)
    front_lever = wheelbase * rng.uniform(0.5, 0.68)
    rear_lever = wheelbase - front_lever
    constants = {
        "mass": mass, "inertia": rng.uniform(0.6, 1.1) * mass * front_lever * rear_lever, "front_lever": front_lever,
        "rear_lever": rear_lever, "rear_track": rng.uniform(0.6, 0.95), "angle_limit": rng.uniform(1.05, 1.57),
        "servo_time": rng.uniform(0.08, 0.25), "servo_rate": rng.uniform(1.0, 2.5),
        "rim_time": rng.uniform(0.15, 0.4), "rim_acceleration": rng.uniform(0.5, 1.2),
        "slip_stiffness": rng.uniform(8.0, 18.0), "grip": rng.uniform(0.6, 0.9), "slip_speed": rng.uniform(0.8, 1.2),
        # a bicycle's tyres on a hard floor
        "rolling_share": rng.uniform(0.003, 0.008), "rolling_growth": rng.uniform(0.0005, 0.002),
        "rough_force": 0.02 * mass, "rough_moment": 0.02 * mass * front_lever * rear_lever,
    }  # fmt: skip
    return Tricycle(**{name: float(value) for name, value in constants.items()})

"""What has no name: smooth functions of state, place and time with free coefficients, which act on the car.

Function j of the remainder is c_j cos(k_j . s + phi_j), s being the quantities in INPUTS, and acts in one of the
DIRECTIONS.  Enough such functions, with coefficients whose prior variance falls with |k_j|, are a Gaussian process by
its spectrum: any smooth law may be one of them, and none of the vocabulary's is (Kennedy and O'Hagan 2001).
"""

from typing import NamedTuple

from bcid.aliases import Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.physics.car import Car
from bcid.physics.elementary import sincos
from bcid.physics.kinematics import wheel_velocity
from bcid.physics.tyres import slip_angle

INPUTS = ("v_x", "omega", "v_fx", "alpha_f", "alpha_r", "delta", "delta_rate", "u_m", "p_x", "p_y", "t")
"""What the functions depend on: m/s and rad/s of the body, the front hub's speed along the wheel (m/s), slip angles
(rad), the steering angle and its rate (rad, rad/s), the throttle, the place on the floor (m), the recording's time (s).
"""

DIRECTIONS = (
    "body_x", "front_along", "front_across", "rear_across", "yaw", "world_x", "world_y", "driven_along", "rolling",
    "wheel_angle",
)  # fmt: skip
"""In which a function acts: as a force over the mass (m/s^2) along or across the body, a wheel or the floor, or the way
that the car rolls, as a moment over the inertia (rad/s^2), or as a change of the steered wheel's angle (rad)."""

BODY_X, FRONT_ALONG, FRONT_ACROSS, REAR_ACROSS, YAW, WORLD_X, WORLD_Y, DRIVEN_ALONG, ROLLING, WHEEL_ANGLE = range(10)
COEFFICIENT, DIRECTION, PHASE, WAVE = 0, 1, 2, 3  # columns of the table of functions; the last and those behind it: k_j
COLUMNS = WAVE + len(INPUTS)
ROLLING_V = 0.05  # m/s, well above which a car rolls: where dry friction has its full size
MOST = 224
"""Functions that the table has room for."""


class RemainderInputs(NamedTuple):
    """The quantities on which a remainder's functions depend, in the order of INPUTS."""

    v_x: float
    omega: float
    v_fx: float
    alpha_f: float
    alpha_r: float
    delta: float
    delta_rate: float
    u_m: float
    p_x: float
    p_y: float
    t: float


class RemainderAction(NamedTuple):
    """What acts on a car beside all that has a name."""

    f_x: float  # force over the mass along the body, m/s^2
    f_y: float  # and across it
    arm: float  # moment of such forces over the mass, m^2/s^2
    alpha: float  # moment over the inertia, rad/s^2
    turn: float  # of the steered wheel, rad


class WheelDirections(NamedTuple):
    """Sines and cosines of the steering angle and of the heading, and which way the car rolls."""

    sin_d: float
    cos_d: float
    sin_t: float
    cos_t: float
    roll: float  # tanh(v_x / ROLLING_V): 1 ahead, -1 backwards


@njit_inline
def no_remainder(like: float) -> RemainderAction:
    """Nothing beside what has a name: zeros of the kind of number that `like` is."""
    none = 0.0 * like
    return RemainderAction(none, none, none, none, none)


@njit_inline
def remainder_inputs(
    p_x: float, p_y: float, v_x: float, v_y: float, omega: float, delta: float, rate: float, u_m: float, t: float,
    p: Car,
) -> RemainderInputs:  # fmt: skip
    """The quantities on which a remainder depends, from place (m), twist (m/s, rad/s), actuation and time (s)."""
    v_fx, v_fy = wheel_velocity(v_x, v_y, omega, p.l_f, delta)
    alpha_f, alpha_r = slip_angle(v_fx, v_fy, p.v_0), slip_angle(v_x, v_y - p.l_r * omega, p.v_0)
    return RemainderInputs(v_x, omega, v_fx, alpha_f, alpha_r, delta, rate, u_m, p_x, p_y, t)


@njit_inline
def function_angle(e: Switches, j: int, s: RemainderInputs) -> float:
    """k_j . s + phi_j (rad) of function `j` of the remainder in `e` at the inputs `s`."""
    k = e.remainder
    angle: float = k[j, PHASE] + k[j, WAVE] * s.v_x + k[j, WAVE + 1] * s.omega + k[j, WAVE + 2] * s.v_fx
    angle += k[j, WAVE + 3] * s.alpha_f + k[j, WAVE + 4] * s.alpha_r + k[j, WAVE + 5] * s.delta
    angle += k[j, WAVE + 6] * s.delta_rate + k[j, WAVE + 7] * s.u_m + k[j, WAVE + 8] * s.p_x
    angle += k[j, WAVE + 9] * s.p_y + k[j, WAVE + 10] * s.t
    return angle


@njit_inline
def remainder_function(e: Switches, j: int, s: RemainderInputs) -> float:
    """cos(k_j . s + phi_j), function `j` of the remainder in `e` at the inputs `s`, without its coefficient."""
    return sincos(function_angle(e, j, s))[1]


@njit_inline
def unit_remainder(direction: float, w: WheelDirections, p: Car) -> RemainderAction:
    """What a function adds whose value is 1 and that acts in a `direction`."""
    zero = 0.0 * w.sin_d
    one = zero + 1.0
    if direction == BODY_X:
        return RemainderAction(one, zero, zero, zero, zero)
    if direction == FRONT_ALONG:
        return RemainderAction(w.cos_d, w.sin_d, p.l_f * w.sin_d, zero, zero)
    if direction == FRONT_ACROSS:
        return RemainderAction(-w.sin_d, w.cos_d, p.l_f * w.cos_d, zero, zero)
    if direction == REAR_ACROSS:
        return RemainderAction(zero, one, zero - p.l_r, zero, zero)
    if direction == YAW:
        return RemainderAction(zero, zero, zero, one, zero)
    if direction == WORLD_X:
        return RemainderAction(w.cos_t, -w.sin_t, zero, zero, zero)
    if direction == WORLD_Y:
        return RemainderAction(w.sin_t, w.cos_t, zero, zero, zero)
    if direction == DRIVEN_ALONG:
        f = p.front_share
        return RemainderAction(f * w.cos_d + (1.0 - f), f * w.sin_d, f * p.l_f * w.sin_d, zero, zero)
    if direction == ROLLING:
        return RemainderAction(w.roll, zero, zero, zero, zero)
    return RemainderAction(zero, zero, zero, zero, one)


@njit_inline
def add_to_remainder(rest: RemainderAction, unit: RemainderAction, amount: float) -> RemainderAction:
    """The remainder `rest` and `amount` times a `unit` more."""
    return RemainderAction(
        rest.f_x + amount * unit.f_x, rest.f_y + amount * unit.f_y, rest.arm + amount * unit.arm,
        rest.alpha + amount * unit.alpha, rest.turn + amount * unit.turn,
    )  # fmt: skip


@njit
def sum_remainder(s: RemainderInputs, w: WheelDirections, p: Car, e: Switches) -> RemainderAction:
    """What all functions of the remainder in `e` add together at the inputs `s`."""
    j, rest = 0, no_remainder(s.v_x)
    while j < e.remainders:
        # functions that follow each other in one direction are turned into it together
        direction, amount = e.remainder[j, DIRECTION], 0.0 * s.v_x
        while j < e.remainders and e.remainder[j, DIRECTION] == direction:
            if e.remainder[j, COEFFICIENT] != 0.0:
                amount += e.remainder[j, COEFFICIENT] * remainder_function(e, j, s)
            j += 1
        rest = add_to_remainder(rest, unit_remainder(direction, w, p), amount)
    return rest

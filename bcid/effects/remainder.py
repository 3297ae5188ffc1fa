"""What has no name: smooth functions of state, place and time with free coefficients, which act on the car.

Function j of the remainder is c_j cos(k_j . s + phi_j), s being the quantities in INPUTS, and acts in one of the
DIRECTIONS.  Enough such functions, with coefficients whose prior variance falls with |k_j|, are a Gaussian process by
its spectrum: any smooth law may be one of them, and none of the vocabulary's is (Kennedy and O'Hagan 2001).
"""

from typing import NamedTuple

from bcid.aliases import Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.harmonics import ON_COSINE, ON_SINE, angle_powers, product_of_powers
from bcid.effects.remainder_table import (
    BODY_X,
    COEFFICIENT,
    DIRECTION,
    DRIVEN_ALONG,
    FRONT_ACROSS,
    FRONT_ALONG,
    REAR_ACROSS,
    ROLLING,
    WORLD_X,
    WORLD_Y,
    YAW,
    RemainderInputs,
)
from bcid.physics.car import Car
from bcid.physics.kinematics import wheel_velocity
from bcid.physics.tyres import slip_angle


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
    j, rest, powers = 0, no_remainder(s.v_x), angle_powers(e, s)
    while j < e.remainders:
        # functions that follow each other in one direction are turned into it together
        direction, amount = e.remainder[j, DIRECTION], 0.0 * s.v_x
        while j < e.remainders and e.remainder[j, DIRECTION] == direction:
            if e.remainder[j, COEFFICIENT] != 0.0:
                x, y = product_of_powers(e, j, powers, s.v_x)
                amount += e.remainder[j, ON_COSINE] * x + e.remainder[j, ON_SINE] * y
            j += 1
        rest = add_to_remainder(rest, unit_remainder(direction, w, p), amount)
    return rest

"""What has no name and how it changes with the state, at a stage of an RK4 step: one pass over its functions.

A function c cos(k . s + phi) changes with its inputs s by -c sin(k . s + phi) k, and the inputs with place and twist by
the chain rule.  Functions that act in one direction are added up before they are turned into it.
"""

from typing import NamedTuple

from bcid.aliases import Floats, Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import Actuation, BodyState, Wrench
from bcid.effects.harmonics import ON_COSINE, ON_SINE, angle_powers, product_of_powers
from bcid.effects.remainder import RemainderAction, WheelDirections, add_to_remainder, no_remainder, unit_remainder
from bcid.effects.remainder_table import (
    COEFFICIENT,
    DIRECTION,
    ROLLING,
    ROLLING_V,
    WAVE,
    WORLD_X,
    WORLD_Y,
    RemainderInputs,
)
from bcid.effects.unnamed_action import inputs_of_remainder, replace_remainder, wheel_directions
from bcid.likelihood.step_derivatives import (
    SLOPE,
    TURN_STEP,
    get,
    put,
)
from bcid.physics.car import Car
from bcid.physics.tyres import slip_angle_slopes


class FunctionSum(NamedTuple):
    """The value of added functions, and its derivatives by the inputs that follow the state."""

    value: float
    v_x: float
    omega: float
    v_fx: float
    alpha_f: float
    alpha_r: float
    p_x: float
    p_y: float


class SlipSlopes(NamedTuple):
    """Derivatives of the slip angles by the velocities of their axles along and across the wheel (s/m)."""

    along_f: float
    across_f: float
    along_r: float
    across_r: float


@njit_inline
def _add_function(total: FunctionSum, e: Switches, j: int, powers: Floats) -> FunctionSum:
    """Function `j` of the remainder in `e`, added to `total`; `powers` are those of `angle_powers`."""
    k, (x, y) = e.remainder, product_of_powers(e, j, powers, total.value)
    slope = k[j, ON_SINE] * x - k[j, ON_COSINE] * y
    return FunctionSum(
        total.value + k[j, ON_COSINE] * x + k[j, ON_SINE] * y,
        total.v_x + slope * k[j, WAVE], total.omega + slope * k[j, WAVE + 1],
        total.v_fx + slope * k[j, WAVE + 2], total.alpha_f + slope * k[j, WAVE + 3],
        total.alpha_r + slope * k[j, WAVE + 4], total.p_x + slope * k[j, WAVE + 8], total.p_y + slope * k[j, WAVE + 9],
    )  # fmt: skip


@njit_inline
def _slip_slopes(b: BodyState, s: RemainderInputs, w: WheelDirections, p: Car) -> SlipSlopes:
    """Derivatives of both slip angles by the velocities (m/s) of their axles along and across the wheel."""
    across = w.cos_d * (b.v_y + p.l_f * b.omega) - w.sin_d * b.v_x
    along_f, across_f = slip_angle_slopes(s.v_fx, across, p.v_0)
    along_r, across_r = slip_angle_slopes(b.v_x, b.v_y - p.l_r * b.omega, p.v_0)
    return SlipSlopes(along_f, across_f, along_r, across_r)


@njit_inline
def _twist_slopes(total: FunctionSum, slip: SlipSlopes, w: WheelDirections, p: Car) -> tuple[float, float, float]:
    """Derivatives of added functions by v_x, v_y and omega, by the chain rule through their inputs."""
    along, aside = total.v_fx + total.alpha_f * slip.along_f, total.alpha_f * slip.across_f
    front, rear = w.sin_d * along + w.cos_d * aside, total.alpha_r * slip.across_r
    ahead = total.v_x + w.cos_d * along - w.sin_d * aside + total.alpha_r * slip.along_r
    return ahead, front + rear, total.omega + p.l_f * front - p.l_r * rear


@njit
def differentiate_remainder(out: Floats, b: BodyState, act: Actuation, p: Car, e: Switches) -> Actuation:
    """What the actuators give, with what the functions in `e` add at the state `b`.

    The derivatives of what they add by pose and twist go to SLOPE in `out`.
    """
    if e.remainders == 0.0:
        return act
    s = inputs_of_remainder(act, b, p, e)
    w = wheel_directions(b, s.delta)
    slip, j, zero, rest = _slip_slopes(b, s, w, p), 0, 0.0 * b.v_x, no_remainder(b.v_x)
    powers = angle_powers(e, s)
    for i in range(6):
        _put_remainder(out, i, rest)
    while j < e.remainders:
        direction, total = e.remainder[j, DIRECTION], FunctionSum(zero, zero, zero, zero, zero, zero, zero, zero)
        while j < e.remainders and e.remainder[j, DIRECTION] == direction:
            if e.remainder[j, COEFFICIENT] != 0.0:
                total = _add_function(total, e, j, powers)
            j += 1
        unit, (v_x, v_y, omega) = unit_remainder(direction, w, p), _twist_slopes(total, slip, w, p)
        rest = add_to_remainder(rest, unit, total.value)
        for i, slope in ((0, total.p_x), (1, total.p_y), (3, v_x), (4, v_y), (5, omega)):
            _put_remainder(out, i, add_to_remainder(slope_of_remainder(out, i), unit, slope))
        # friction turns round where the car does
        if direction == ROLLING:
            steeper = (1.0 - w.roll * w.roll) * total.value / ROLLING_V
            ahead = RemainderAction(zero + 1.0, zero, zero, zero, zero)
            _put_remainder(out, 3, add_to_remainder(slope_of_remainder(out, 3), ahead, steeper))
        # what points somewhere in the world turns against the body
        if direction in (WORLD_X, WORLD_Y):
            turned = RemainderAction(unit.f_y, -unit.f_x, zero, zero, zero)
            _put_remainder(out, 2, add_to_remainder(slope_of_remainder(out, 2), turned, total.value))
    return replace_remainder(act, rest)


@njit_inline
def slope_of_remainder(d: Floats, i: int) -> RemainderAction:
    """The derivative of what has no name by component `i` (0 to 5) of pose and twist, from a step's derivatives."""
    at = SLOPE + 5 * i
    return RemainderAction(get(d, at), get(d, at + 1), get(d, at + 2), get(d, at + 3), get(d, at + 4))


@njit_inline
def _put_remainder(out: Floats, i: int, slope: RemainderAction) -> None:
    """Write the derivative of what has no name by component `i` of pose and twist to a step's derivatives."""
    at = SLOPE + 5 * i
    put(out, at, slope.f_x)
    put(out, at + 1, slope.f_y)
    put(out, at + 2, slope.arm)
    put(out, at + 3, slope.alpha)
    put(out, at + 4, slope.turn)


@njit_inline
def accelerations_by(rest: RemainderAction, now: Wrench, turned: Wrench, p: Car) -> tuple[float, float, float]:
    """Accelerations (m/s^2, m/s^2, rad/s^2) by a small remainder `rest`, to first order, beside the wrench `now`.

    `turned` is that wrench with the wheel turned by TURN_STEP.
    """
    per_rad, ratio = rest.turn / (TURN_STEP * now.mass_factor), p.m / p.I_z
    return (
        rest.f_x / now.mass_factor + per_rad * (turned.F_x - now.F_x) / p.m,
        rest.f_y / now.mass_factor + per_rad * (turned.F_y - now.F_y) / p.m,
        (ratio * rest.arm + rest.alpha) / now.mass_factor + per_rad * (turned.M_z - now.M_z) / p.I_z,
    )

"""What functions without a name do to a car at a state: what they depend on there, and what they add."""

import math

from bcid.aliases import Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import Actuation, BodyState
from bcid.effects.linkage import angle_at_rest
from bcid.effects.remainder import RemainderAction, WheelDirections, remainder_inputs, sum_remainder
from bcid.effects.remainder_table import ROLLING_V, RemainderInputs
from bcid.physics.car import Car
from bcid.physics.elementary import sincos


@njit_inline
def replace_remainder(act: Actuation, rest: RemainderAction) -> Actuation:
    """What the actuators give, with what has no name replaced by `rest`."""
    return Actuation(
        act.t, act.T, act.delta, act.delta_rate, act.u_m, act.u_next, act.late, act.brake, rest
    )  # fmt: skip


@njit_inline
def turn_wheel(act: Actuation, by: float, e: Switches) -> Actuation:
    """What the actuators give, the steered wheel turned further `by` (rad), whatever effects are on in `e`."""
    # a car with neither effects nor anything without a name, whose wheel stands as it is steered, asks for no `rest`
    steered = by if e.any_on_body == 0.0 and e.remainders == 0.0 else 0.0
    rest = act.rest
    turned = RemainderAction(rest.f_x, rest.f_y, rest.arm, rest.alpha, rest.turn + by)
    return Actuation(
        act.t, act.T, act.delta + steered, act.delta_rate, act.u_m, act.u_next, act.late, act.brake, turned
    )  # fmt: skip


@njit
def add_remainder(act: Actuation, b: BodyState, p: Car, e: Switches) -> Actuation:
    """What the actuators give, with what the functions without a name in `e` add at the state `b`."""
    if e.remainders == 0.0:
        return act
    s = inputs_of_remainder(act, b, p, e)
    return replace_remainder(act, sum_remainder(s, wheel_directions(b, s.delta), p, e))


@njit_inline
def inputs_of_remainder(act: Actuation, b: BodyState, p: Car, e: Switches) -> RemainderInputs:
    """What a remainder depends on at a state; of a throttle that changes within a step, the mean.

    The angle is the wheel's, as a tyre feels it, and its rate the servo's.
    """
    delta = angle_at_rest(act.delta, e)
    u_m = act.u_m + act.late * (act.u_next - act.u_m)
    return remainder_inputs(b.p_x, b.p_y, b.v_x, b.v_y, b.omega, delta, act.delta_rate, u_m, act.t, p)


@njit_inline
def wheel_directions(b: BodyState, delta: float) -> WheelDirections:
    """Sines and cosines of the wheel's angle `delta` (rad) and of the heading, and which way the car rolls."""
    sin_d, cos_d = sincos(delta)
    sin_t, cos_t = sincos(b.theta)
    return WheelDirections(sin_d, cos_d, sin_t, cos_t, math.tanh(b.v_x / ROLLING_V))

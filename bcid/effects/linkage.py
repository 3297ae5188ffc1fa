"""The linkage between servo and steered wheel: the angle to which it turns a wheel that no force and no speed turns."""

from bcid.aliases import Switches
from bcid.compiled.njit import njit_inline
from bcid.effects import corrections, steering


@njit_inline
def linkage_angle(delta: float, e: Switches) -> float:
    """Angle (rad) of the front wheel at the angle `delta` behind servo, lag and play, but for an offset."""
    delta = corrections.steering_scale(delta, e.steering_scale__g)
    delta = steering.steering_nonlinearity(delta, e.steering_nonlinearity__k)
    return steering.steering_side_gain(delta, e.steering_side_gain__a)


@njit_inline
def angle_at_rest(delta: float, e: Switches) -> float:
    """Angle (rad) to which the linkage turns the front wheel of a car at rest: what a remainder depends on."""
    return steering.steering_offset(linkage_angle(delta, e), e.steering_offset__o)

"""Laws of another shape than the vocabulary's, as authors of small cars' models publish them.

Each has a constant of the plant that is zero where the plant keeps its usual law.  Functions take plain numbers, so
that whoever fits the usual laws to these can call them over a range.
"""

import math

from bcid.compiled.njit import njit

# of a steered wheel that drags: how soon with its angle (1/rad), and where and how sharply with the speed
STEERED_PER_RAD, STEERED_FROM_MPS, STEERED_PER_MPS, STEERED_USUAL_MPS = 30.0, 0.3, 20.0, 0.5
SIDES_PER_RAD = 80.0  # how sharply the steering's left half goes over into its right half


@njit
def throttle_gate(command: float, zone: float, steepness: float) -> float:
    """Share of its law that a motor follows at the throttle `command`: ½(1 + tanh(steepness (command - zone))).

    It goes from 0 to 1 about the dead zone's end `zone`, the sooner the larger `steepness` (per unit throttle).
    """
    return 0.5 * (1.0 + math.tanh(steepness * (command - zone)))


@njit
def magic_side_force(linear: float, grip: float, shape: float, curvature: float) -> float:
    """Side force (N) of a tyre by Pacejka's magic formula, D sin(C atan(x - E (x - atan x))).

    `linear` (N) is the force without a limit, D the `grip` (N), C the `shape` and E the `curvature`; with
    x = linear/(C D) the slope at no slip is that of `linear` (Pacejka 2012, ch. 4).
    """
    x = linear / (shape * grip)
    return grip * math.sin(shape * math.atan(x - curvature * (x - math.atan(x))))


@njit
def regularised_speed(rolling: float, floor: float, fade: float) -> float:
    """Speed (m/s) by which slip is divided: |v| + floor exp(-fade v²) at the `rolling` speed v (m/s).

    `floor` (m/s) is what is left at rest, `fade` (s²/m²) how soon it goes.
    """
    return abs(rolling) + floor * math.exp(-fade * rolling * rolling)


@njit
def dry_steered_drag(angle: float, rolling: float, friction: float, rise: float) -> float:
    """Drag (N) of a wheel steered by `angle` (rad) that rolls at `rolling` (m/s): nearly dry, in proportion to it.

    c |δ| tanh(30 |δ|) · ½(1 + tanh(20 (|v| - 0.3))) · (1 + rise (|v| - 0.5)) against the motion, where c is `friction`
    (N/rad) and `rise` (s/m) how much the drag grows with the speed.
    """
    turned, speed = abs(angle), abs(rolling)
    comes = 0.5 * (1.0 + math.tanh(STEERED_PER_MPS * (speed - STEERED_FROM_MPS)))
    size = friction * turned * math.tanh(STEERED_PER_RAD * turned) * comes
    return math.copysign(size * (1.0 + rise * (speed - STEERED_USUAL_MPS)), rolling)


@njit
def two_sided_angle(angle: float, centre: float, left_reach: float, right_reach: float) -> float:
    """Angle (rad) of a wheel whose linkage ends at `left_reach` and `right_reach` (rad), for the servo's `angle` (rad).

    On either side it is reach tanh((angle - centre) / reach), with a slope of 1 at the `centre` (rad).
    """
    turned = angle - centre
    left = left_reach * math.tanh(turned / left_reach)
    right = right_reach * math.tanh(turned / right_reach)
    share = 0.5 * (1.0 + math.tanh(SIDES_PER_RAD * turned))
    return share * left + (1.0 - share) * right


@njit
def servo_acceleration(miss: float, rate: float, time: float, damping: float, limit: float) -> float:
    """Acceleration (rad/s²) of a servo of second order that is `miss` (rad) short of its command and turns at `rate`.

    ω² miss - 2 ζ ω rate with the `damping` ζ and ω = 2 ζ / `time` (s), so that it trails a steady turn by `time` as one
    of first order does; beyond the `limit` (rad/s) it does not get faster.
    """
    pace = 2.0 * damping / time
    wanted = pace * pace * miss - 2.0 * damping * pace * rate
    return 0.0 if abs(rate) >= limit and wanted * rate > 0.0 else wanted

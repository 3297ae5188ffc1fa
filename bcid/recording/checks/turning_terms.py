"""What the turning of a car is explained by: terms of the commanded steering angle, the speed and understeering.

The yaw rate is v g(delta) (1 + understeer v^2) with any smooth map g of the servo's angle delta:

    omega = v (w_0 + w_1 x + w_2 x^2 + w_3 x^3) + w_4 v (v / v_top)^2 x,    x = delta / max |delta|.
"""

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.agreement import Feature
from bcid.recording.checks.commanded_motion import CommandedMotion, command_rows

OTHER_SIGN = np.array([1.0, -1.0, 1.0, -1.0, -1.0])
"""By what each term is multiplied when the angle changes its sign."""


def turning_terms(motion: CommandedMotion, delta: Floats) -> list[Feature]:
    """The terms w_0 to w_4 of the yaw rate at servo angles delta (N,) in rad; w_0's does not move with the commands."""
    x = delta / max(float(np.abs(delta).max()), 1e-9)
    v, fast = motion.speed, (motion.speed / motion.top_speed) ** 2
    return [Feature(v, None), Feature(v, x), Feature(v, x * x), Feature(v, x**3), Feature(v * fast, x)]


def turns_leftward(weights: Floats) -> Bools:
    """Whether weights (..., 5) turn the car to the left where the command says left.

    By the odd terms from one end of the steering to the other, at the speed at which v^2 is half its largest.
    """
    return np.asarray(weights[..., 1] + weights[..., 3] + 0.5 * weights[..., 4] > 0.0)


def terms_at(terms: list[Feature], known: Bools, rows: Ints, lag: int) -> tuple[Floats, Bools]:
    """The terms (K, n) at `rows` (K,) with commands that act `lag` rows later than stamped, zero where unknown.

    Also returns in which of these rows (K,) the command is `known` (N,).
    """
    at, under = command_rows(known, rows, lag)
    return np.column_stack([under * f.still[rows] * (1.0 if f.moving is None else f.moving[at]) for f in terms]), under

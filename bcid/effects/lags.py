"""First-order lags in closed form, for the effects that lag: tyre relaxation, motor lag and steering lag."""

import math

from bcid.compiled.lanes import where
from bcid.compiled.njit import njit

SHORTEST_RATIO = 1e-2  # time constants in a step below which integrals of a decay are taken as series


@njit
def first_order_lag(y: float, u_0: float, u_1: float, ratio: float) -> float:
    """Exact value after `ratio` time constants of tau y' = u - y from `y` on, u running linearly from u_0 to u_1."""
    E = math.exp(-ratio)
    passed = ratio != 0.0
    after = u_1 - (u_1 - u_0) * (1.0 - E) / where(passed, ratio, 1.0) + (y - u_0) * E
    return where(passed, after, y)


@njit
def decay_at_stage(miss: float, ratio: float, share: float) -> float:
    """Value at the `share` (0, 1/2 or 1) of an RK4 step that stands there for a decay from `miss`.

    The deviation decays exponentially by `ratio` time constants in the step.  The middle's value is its own; with the
    ends' values RK4 keeps the decay's integral over the step, and its second integral, however fast it is.
    """
    half = math.exp(-0.5 * ratio)
    if share == 0.5:
        return miss * half
    fades, E = ratio > SHORTEST_RATIO, half * half
    r = where(fades, ratio, 1.0)
    series_1 = 1.0 - ratio * (0.5 - ratio * (1.0 / 6.0 - ratio * (1.0 / 24.0 - ratio / 120.0)))
    series_2 = 0.5 - ratio * (1.0 / 6.0 - ratio * (1.0 / 24.0 - ratio * (1.0 / 120.0 - ratio / 720.0)))
    once = where(fades, (1.0 - E) / r, series_1)
    twice = where(fades, (r - 1.0 + E) / (r * r), series_2)
    begin = 6.0 * twice - 2.0 * half
    return miss * begin if share == 0.0 else miss * (6.0 * once - 4.0 * half - begin)

"""First-order lags in closed form, for the effects that lag: tyre relaxation, motor lag and steering lag."""

import math

from bcid.compiled.lanes import where
from bcid.compiled.njit import njit

SHORTEST_RATIO = 1e-9  # time constants in a step below which its mean is its value at the start


@njit
def first_order_lag(y: float, u_0: float, u_1: float, ratio: float) -> float:
    """Exact value after `ratio` time constants of tau y' = u - y from `y` on, u running linearly from u_0 to u_1."""
    E = math.exp(-ratio)
    passed = ratio != 0.0
    after = u_1 - (u_1 - u_0) * (1.0 - E) / where(passed, ratio, 1.0) + (y - u_0) * E
    return where(passed, after, y)


@njit
def mean_of_decay(miss: float, ratio: float) -> float:
    """Mean of a deviation that decays exponentially from `miss` in `ratio` time constants: miss (1-e^-ratio)/ratio."""
    fades = ratio > SHORTEST_RATIO
    return where(fades, miss * (1.0 - math.exp(-ratio)) / where(fades, ratio, 1.0), miss)

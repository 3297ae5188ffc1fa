"""What an optimiser returns."""

from typing import NamedTuple

from bcid.aliases import Floats


class Optimum(NamedTuple):
    """The best point that an optimiser found in the unit box."""

    x: Floats  # (n,)
    cost: float
    history: list[float]  # the best cost after each generation, or after each start

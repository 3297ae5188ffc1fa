"""Whether the constants of two fits differ by more than chance.

Two fits of different drives have independent errors, so that for a constant with the values a and b

    z = (b - a) / sqrt(s_a^2 + s_b^2),

where s_a and s_b are the standard errors, the square roots of the diagonal of either fit's covariance.  Constants of
one fit are correlated with each other, so that their z are no independent tests: a difference counts where its |z| is
beyond the quantile for which, by Bonferroni's inequality, which holds whatever the correlations are, all n constants
of two fits of the same car agree in a share 1 - LIMITS.max_chance of cases.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bcid.evaluation.limits import LIMITS


class KnownConstant(NamedTuple):
    """A constant of a fit with its standard error, in its unit."""

    value: float
    se: float
    unit: str


class ConstantDifference(NamedTuple):
    """How one constant of a second fit differs from that of a first."""

    symbol: str
    one: KnownConstant
    other: KnownConstant

    @property
    def change(self) -> float:
        """The second value less the first."""
        return self.other.value - self.one.value

    @property
    def change_se(self) -> float:
        """The standard error of the change."""
        return float((self.one.se**2 + self.other.se**2) ** 0.5)

    @property
    def z(self) -> float:
        """The change over its standard error."""
        return self.change / self.change_se

    @property
    def share(self) -> float | None:
        """The change over the first value; None where that is zero."""
        return self.change / abs(self.one.value) if self.one.value else None


def list_differences(
    one: Mapping[str, KnownConstant], other: Mapping[str, KnownConstant]
) -> tuple[ConstantDifference, ...]:
    """Differences of the constants, by symbol, that both fits know with an error above zero, in the first's order."""
    return tuple(
        ConstantDifference(symbol, constant, other[symbol])
        for symbol, constant in one.items()
        if symbol in other and constant.se**2 + other[symbol].se ** 2 > 0.0
    )


def z_beyond_chance(count: int) -> float:
    """The |z| that some of `count` constants of fits of one car passes in a share LIMITS.max_chance of cases at most.

    >>> round(z_beyond_chance(1), 2), round(z_beyond_chance(10), 2)
    (2.58, 3.29)
    """
    from scipy.stats import norm

    return float(norm.isf(LIMITS.max_chance / (2 * max(count, 1))))


def chance_of_differences(differences: Sequence[ConstantDifference]) -> float:
    """How often two fits of one car differ in any of these constants by as much as here, at most: a p-value."""
    from scipy.stats import norm

    largest = max((abs(d.z) for d in differences), default=0.0)
    return min(1.0, 2.0 * len(differences) * float(norm.sf(largest))) if differences else 1.0

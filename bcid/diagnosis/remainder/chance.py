"""What functions without a name explain by chance beside a fit, as pushes are more uneven than it takes them to be.

The likelihood holds pushes constant over a quarter of a second, and takes them to last by an autoregression.  A floor
is rough in its own way: what varies otherwise passes for more information than there is, and functions that have
nothing to do with the take explain some of it.  What stays uneven for longer than a segment is not seen so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.diagnosis.kept_steps import kept_under
from bcid.diagnosis.remainder.explain import explained_elsewhere
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.remainder.information import gather_information
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take

# From these the law of chance is found: what is said to be reached once in 100 takes is reached in 60 to 80, and once
# in 10,000 in 2,000 to 3,000.
DRAWS = 50
SEED = 0  # of these draws


class Chance(NamedTuple):
    """The law of the nats that functions explain by chance: a gamma law of this mean and standard deviation."""

    mean: float
    sd: float

    @property
    def scale(self) -> float:
        """Scale (nats) of the gamma law, whose shape is the mean over it; 0 where chance explains nothing."""
        return self.sd**2 / self.mean if self.mean > 0.0 else 0.0

    def reached_with(self, p: float) -> float:
        """Nats that chance reaches with probability `p`; 0 where it reaches none."""
        from scipy.special import gammainccinv

        scale = self.scale
        return float(scale * gammainccinv(self.mean / scale, p)) if scale > 0.0 else self.mean

    def p_value(self, nats: float) -> float:
        """Probability that chance reaches so many `nats`."""
        from scipy.special import gammaincc

        scale = self.scale
        above = gammaincc(self.mean / scale, max(nats, 0.0) / scale) if scale > 0.0 else nats <= self.mean
        return float(above)


@kept_under()
def draw_chance(fit: Fit, take: Take, basis: RemainderBasis) -> Chance:
    """The law of what functions of a `basis` explain beside a `fit` by chance, by some draws.

    In each draw the functions of a segment are those of what another one, drawn by lot, went through, which have
    nothing to do with its residual.
    """
    at, rng = gather_information(fit, take, basis, np.zeros(len(basis.size))), np.random.default_rng(SEED)
    orders = [rng.permutation(take.segments) for _ in range(DRAWS)]
    nats = [explained_elsewhere(fit, at.carried_elsewhere(order), basis) for order in orders]
    return Chance(float(np.mean(nats)), float(np.std(nats, ddof=1)))

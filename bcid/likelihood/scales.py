"""How large the noise of poses and the pushes of a car are, and how long pushes last."""

import functools
import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START

INDEPENDENT = np.zeros(3)  # correlations of pushes that do not last
INDEPENDENT.setflags(write=False)


class Scales(NamedTuple):
    """Standard deviations of the noise (m, m, rad) and of the pushes (m/s^2, m/s^2, rad/s^2), and how these last."""

    r: Floats  # (3,)
    q: Floats  # (3,)
    rho: Floats = INDEPENDENT  # correlation of each push with the next one

    def nuisance_precision(self) -> Floats:
        """Prior precision (N_NUISANCE, N_NUISANCE) of [initial state, pushes]: zero for the initial state.

        Of the pushes it is that of autoregressive ones of first order, Q^-1.
        """
        return _nuisance_precision(tuple(self.q.tolist()), tuple(self.rho.tolist()))


@functools.lru_cache(maxsize=16)  # refits come back to the same scales, many times within a step
def _nuisance_precision(q: tuple[float, ...], rho: tuple[float, ...]) -> Floats:
    """The precision of `Scales.nuisance_precision`, which must not be written to."""
    known = np.zeros((N_NUISANCE, N_NUISANCE))
    pushes = known[N_START:, N_START:].reshape(KNOTS, 3, KNOTS, 3)
    last, inner = np.eye(KNOTS, k=1) + np.eye(KNOTS, k=-1), np.diag(np.r_[0.0, np.ones(KNOTS - 2), 0.0])
    for c, (sd, lasts) in enumerate(zip(q, rho, strict=True)):
        pushes[:, c, :, c] = (np.eye(KNOTS) - lasts * last + lasts**2 * inner) / ((1.0 - lasts**2) * sd**2)
    known.setflags(write=False)
    return known


UNLIMITED = Scales(np.full(3, math.inf), np.full(3, math.inf), np.full(3, LIKELIHOOD_LIMITS.most_lasting))

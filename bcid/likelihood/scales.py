"""How large noise and pushes are, and how long pushes last: the scales of a fit, which it estimates."""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START

MIN_VARIANCE = 1e-10  # what is left of a difference of large numbers may be negative
PERSISTENCES = np.arange(0.0, 0.96, 0.005)  # correlations of neighbouring pushes that are tried


class Scales(NamedTuple):
    """Standard deviations of the noise (m, m, rad) and of the pushes (m/s^2, m/s^2, rad/s^2), and how these persist.

    The pushes of a segment are a stationary autoregression: p_k+1 = rho p_k + sqrt(1 - rho^2) q N(0, 1), since what
    pushes a car, such as a rough floor, lasts for longer than an instant.
    """

    r: Floats  # (3,)
    q: Floats  # (3,)
    rho: Floats = np.zeros(3)  # correlation of a push with the next one, 0.125 s later

    def nuisance_precision(self) -> Floats:
        """Prior precision (N_NUISANCE, N_NUISANCE) of [initial state, pushes]: zero for the initial state."""
        known = np.zeros((N_NUISANCE, N_NUISANCE))
        pushes = known[N_START:, N_START:].reshape(KNOTS, 3, KNOTS, 3)
        for c in range(3):
            pushes[:, c, :, c] = autoregressive_precision(self.rho[c]) / self.q[c] ** 2
        return known


def autoregressive_precision(rho: float) -> Floats:
    """Inverse (KNOTS, KNOTS) of the correlation rho^|i - j| of an autoregression."""
    inner = np.diag([1.0, *np.full(KNOTS - 2, 1.0 + rho**2), 1.0])
    beside = np.eye(KNOTS, k=1) + np.eye(KNOTS, k=-1)
    return np.asarray((inner - rho * beside) / (1.0 - rho**2))


UNLIMITED = Scales(np.full(3, math.inf), np.full(3, math.inf))


def likeliest_persistence(products: Floats) -> float:
    """The rho in the range of PERSISTENCES that makes pushes over their standard deviation likeliest.

    `products` (KNOTS, KNOTS) are means over segments.

    Of an autoregression the log-likelihood is -(K - 1)/2 log(1 - rho^2) - (a - 2 rho b + rho^2 c)/(2 (1 - rho^2)), with
    a the sum of all squares, b of products of neighbours, c of the squares of those with two neighbours.
    """
    a, b, c = np.trace(products), np.trace(products, offset=1), np.trace(products[1:-1, 1:-1])
    free = 1.0 - PERSISTENCES**2
    nats = -0.5 * (KNOTS - 1) * np.log(free) - 0.5 * (a - 2.0 * PERSISTENCES * b + PERSISTENCES**2 * c) / free
    best = int(np.argmax(nats))
    if best in (0, len(nats) - 1):
        return float(PERSISTENCES[best])
    # the vertex of the parabola through three neighbours, as a likelihood that moves by steps has no slope
    before, there, after = nats[best - 1 : best + 2]
    step = PERSISTENCES[1] - PERSISTENCES[0]
    return float(PERSISTENCES[best] + 0.5 * step * (before - after) / (before - 2.0 * there + after))


def as_vector(scales: Scales) -> Floats:
    """Scales as (9,) numbers of alike size: logarithms of standard deviations, and rho."""
    return np.asarray(np.r_[np.log(scales.r), np.log(scales.q), scales.rho])


def from_vector(vector: Floats, most: Scales) -> Scales:
    """The scales of `as_vector`, within their ranges."""
    r, q = (np.sqrt(np.maximum(np.exp(2.0 * log), MIN_VARIANCE)) for log in (vector[:3], vector[3:6]))
    rho = np.clip(vector[6:], PERSISTENCES[0], PERSISTENCES[-1])
    return Scales(np.minimum(r, most.r), np.minimum(q, most.q), rho)

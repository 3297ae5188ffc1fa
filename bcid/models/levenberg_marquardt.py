"""Levenberg-Marquardt (scipy's, within bounds) from several starts: on a part of the samples, then the best on all."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from bcid.models.genetic import Optimum
from bcid.models.interface import Progress

Floats = npt.NDArray[np.float64]
Misses = Callable[[Floats], Floats]  # points (P, n) of the unit box to residuals (P, N), whose squares sum to the cost

STEP = 1e-5  # for differences
FIRST, LAST = 30, 15  # evaluations of the slope from each start, and of the best on all samples
SETTLED = 1e-4  # relative change of cost and point at which a start ends; the best goes on to its square


def minimise(part: Misses, whole: Misses, starts: Sequence[Floats], progress: Progress) -> Optimum:
    """The smallest sum of squares over the unit box: `part`'s from each start, then `whole`'s from the best of them.

    Raises:
        FloatingPointError: no start leads to finite residuals.
    """
    from scipy.optimize import least_squares

    def run(misses: Misses, x: Floats, most: int, settled: float) -> tuple[float, Floats]:
        def residuals(at: Floats) -> Floats:
            return np.asarray(misses(at[None])[0])

        def jacobian(at: Floats) -> Floats:
            return slopes(misses, at)

        found = least_squares(residuals, x, jacobian, bounds=(0.0, 1.0), max_nfev=most, xtol=settled, ftol=settled)
        return 2.0 * float(found.cost), found.x

    ends, history = list[tuple[float, Floats]](), list[float]()
    for k, start in enumerate(starts):
        if np.isfinite(part(start[None])).all():
            ends.append(run(part, start, FIRST, SETTLED))
            history.append(min(cost for cost, _ in ends))
        progress((k + 1) / (len(starts) + 1), f"start {k + 1} of {len(starts)}")
    if not ends:
        raise FloatingPointError("no start of the fit stays within the finite numbers")
    cost, x = run(whole, min(ends, key=lambda end: end[0])[1], LAST, SETTLED**2)
    progress(1.0, f"NMSE {cost:.3e}")
    return Optimum(x, cost, [*history, cost])


def slopes(misses: Misses, x: Floats) -> Floats:
    """D misses / d x (N, n) by one-sided differences towards the middle of the box, all in one call."""
    steps = np.where(x < 0.5, STEP, -STEP)
    found = misses(np.vstack([x, x + np.diag(steps)]))
    return np.asarray(((found[1:] - found[0]) / steps[:, None]).T)

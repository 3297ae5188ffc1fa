"""Levenberg-Marquardt (scipy's, within bounds) from several starts: on a part of the samples, then the best on all.

Only J^T J, J^T r and r^T r of a point are needed: with J^T J = R^T R the small problem of residuals [R^-T J^T r, rest]
and Jacobian [R, 0] has the same slope, curvature and cost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Progress
from bcid.models.fitting.genetic import Optimum


class Normal(NamedTuple):
    """J^T J, J^T r and r^T r at a point."""

    JJ: Floats  # (n, n)
    Jr: Floats  # (n,)
    rr: float


At = Callable[[Floats], Normal]  # a point (n,) of the unit box

FIRST, LAST = 30, 15  # evaluations from each start, and of the best on all samples
SETTLED = 1e-4  # relative change of cost and point at which a start ends
ENDED = 1e-7  # and the best of them
NOTHING = 1e-14  # of the largest curvature: a direction that does not act


def minimise(part: At, whole: At, starts: Sequence[Floats], progress: Progress) -> Optimum:
    """The smallest sum of squares over the unit box: `part`'s from each start, then `whole`'s from the best of them.

    Raises:
        FloatingPointError: no start leads to finite residuals.
    """
    ends, history = list[Optimum](), list[float]()
    for k, start in enumerate(starts):
        here = part(start)
        if np.isfinite(here.rr):
            ends.append(_descended(part, start, here, FIRST, SETTLED))
            history.append(min(end.cost for end in ends))
        progress((k + 1) / (len(starts) + 1), f"start {k + 1} of {len(starts)}")
    if not ends:
        raise FloatingPointError("no start of the fit stays within the finite numbers")
    nearest = min(ends, key=lambda end: end.cost).x
    best = _descended(whole, nearest, whole(nearest), LAST, ENDED)
    progress(1.0, f"NMSE {best.cost:.3e}")
    return Optimum(best.x, best.cost, [*history, best.cost])


def _descended(at: At, start: Floats, here: Normal, most: int, settled: float) -> Optimum:
    """Where one descent from `start`, whose normal equations are `here`, ends."""
    from scipy.optimize import least_squares

    known = {start.tobytes(): compressed(here)}

    def small(x: Floats) -> tuple[Floats, Floats]:
        key = x.tobytes()
        if key not in known:
            known[key] = compressed(at(x))
        return known[key]

    def residuals(x: Floats) -> Floats:
        return small(x)[0]

    def jacobian(x: Floats) -> Floats:
        return small(x)[1]

    found = least_squares(residuals, start, jacobian, bounds=(0.0, 1.0), max_nfev=most, xtol=settled, ftol=settled)
    return Optimum(found.x, 2.0 * float(found.cost), [])


def compressed(normal: Normal) -> tuple[Floats, Floats]:
    """Residuals (n + 1,) and Jacobian (n + 1, n) of the small problem."""
    n = len(normal.Jr)
    if not (np.isfinite(normal.JJ).all() and np.isfinite(normal.rr)):
        return np.full(n + 1, np.inf), np.zeros((n + 1, n))  # no step leads here
    values, vectors = np.linalg.eigh(normal.JJ)
    acting = values > NOTHING * max(values[-1], 0.0)
    root = np.sqrt(np.where(acting, values, 0.0))
    f = np.where(acting, vectors.T @ normal.Jr, 0.0) / np.where(acting, root, 1.0)
    rest = np.sqrt(max(normal.rr - float(f @ f), 0.0))
    return np.r_[f, rest], np.vstack([root[:, None] * vectors.T, np.zeros(n)])

"""Levenberg-Marquardt (scipy's, within bounds) from several starts: on a part of the samples, then the best on all.

Only J^T J, J^T r and r^T r of a point are needed: with J^T J = R^T R the small problem of residuals [R^-T J^T r, rest]
and Jacobian [R, 0] has the same gradient, curvature and cost.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Progress
from bcid.errors import PredictionDiverged
from bcid.models.fitting.optimum import Optimum


class NormalEquations(NamedTuple):
    """J^T J, J^T r and r^T r of residuals r with Jacobian J at one point."""

    JJ: Floats  # (n, n)
    Jr: Floats  # (n,)
    rr: float


NormalAt = Callable[[Floats], NormalEquations]  # at a point (n,) of the unit box

# Evaluations, and the relative change of cost and point that ends a descent: from each start on a part of the samples,
# then from the best of these points on all samples.
START_EVALUATIONS, FINAL_EVALUATIONS = 30, 15
START_TOLERANCE, FINAL_TOLERANCE = 1e-4, 1e-7
# Curvature over the largest, below which a direction is taken not to act.
MIN_CURVATURE = 1e-14


def minimise_squares(
    subset_normal: NormalAt, full_normal: NormalAt, starts: Sequence[Floats], progress: Progress
) -> Optimum:
    """Minimise the sum of squares r^T r over the unit box [0, 1]^n by bounded least squares from several starts.

    From each of `starts` (n,) it descends on a part of the samples, then from the best of their ends on all samples.
    `subset_normal` and `full_normal` give J^T J, J^T r and r^T r at a point, for the part and for all samples.

    Raises:
        PredictionDiverged: the residuals are finite at none of the starts.
    """
    ends, history = list[Optimum](), list[float]()
    for k, start in enumerate(starts):
        here = subset_normal(start)
        if np.isfinite(here.rr):
            ends.append(_descend_from(subset_normal, start, here, START_EVALUATIONS, START_TOLERANCE))
            history.append(min(end.cost for end in ends))
        progress((k + 1) / (len(starts) + 1), f"start {k + 1} of {len(starts)}")
    if not ends:
        raise PredictionDiverged("no start of the fit stays within the finite numbers")
    nearest = min(ends, key=lambda end: end.cost).x
    best = _descend_from(full_normal, nearest, full_normal(nearest), FINAL_EVALUATIONS, FINAL_TOLERANCE)
    progress(1.0, f"NMSE {best.cost:.3e}")
    return Optimum(best.x, best.cost, [*history, best.cost])


def _descend_from(
    normal_at: NormalAt, start: Floats, start_normal: NormalEquations, max_evaluations: int, tolerance: float
) -> Optimum:
    """Minimise r^T r over the unit box [0, 1]^n from one point `start` (n,), by bounded least squares.

    `normal_at` gives J^T J, J^T r, r^T r at a point, `start_normal` is its value at `start`.  The descent ends when
    cost or point change by less than the relative `tolerance`, or after `max_evaluations`.
    """
    from scipy.optimize import least_squares

    known = {start.tobytes(): compress_normal_equations(start_normal)}

    def compressed_at(part: int, x: Floats) -> Floats:
        key = x.tobytes()
        if key not in known:
            known[key] = compress_normal_equations(normal_at(x))
        return known[key][part]

    end = least_squares(
        partial(compressed_at, 0), start, partial(compressed_at, 1), bounds=(0.0, 1.0),
        max_nfev=max_evaluations, xtol=tolerance, ftol=tolerance,
    )  # fmt: skip
    return Optimum(end.x, 2.0 * float(end.cost), [])


def compress_normal_equations(normal: NormalEquations) -> tuple[Floats, Floats]:
    """A small least-squares problem equivalent to normal equations: residuals f (n + 1,) and Jacobian G (n + 1, n).

    `normal` holds J^T J, J^T r, r^T r of many samples; G^T G, G^T f, f^T f equal these.  Where they are not finite, f
    is infinite and G zero, so that the optimiser rejects the point.
    """
    n = len(normal.Jr)
    if not (np.isfinite(normal.JJ).all() and np.isfinite(normal.rr)):
        # Infinite residuals: least squares takes no step to such a point.
        return np.full(n + 1, np.inf), np.zeros((n + 1, n))
    values, vectors = np.linalg.eigh(normal.JJ)
    acting = values > MIN_CURVATURE * max(values[-1], 0.0)
    root = np.sqrt(np.where(acting, values, 0.0))
    f = np.where(acting, vectors.T @ normal.Jr, 0.0) / np.where(acting, root, 1.0)
    rest = np.sqrt(max(normal.rr - float(f @ f), 0.0))
    return np.r_[f, rest], np.vstack([root[:, None] * vectors.T, np.zeros(n)])

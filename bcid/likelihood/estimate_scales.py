"""Scales of noise and pushes of greatest likelihood, by expectation maximisation (EM) with leaps."""

from collections.abc import Sequence

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.errors import PredictionDiverged
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.marginal import (
    MarginalTerms,
    Moments,
    checked_marginal_terms,
    robust_weights,
    student_log_densities,
    terms_within_rounding,
)
from bcid.likelihood.scales import (
    MIN_VARIANCE,
    UNLIMITED,
    Scales,
    as_vector,
    autoregressive_precision,
    from_vector,
    likeliest_persistence,
)
from bcid.likelihood.take import KNOTS, N_START

EM_STEPS_BEFORE_LEAPS = 2  # of a call that is to take so many, none is a leap
EM_TOLERANCE = 1e-3  # relative change of the scales at which EM ends


def estimate_scales(
    moments: Moments, scales: Scales, steps: int, most: Scales = UNLIMITED
) -> tuple[Scales, MarginalTerms]:
    """Maximum-likelihood scales of noise and pushes, and the segments' marginal likelihood terms there.

    Expectation maximisation (EM) takes at most `steps` from `scales`, and ends where they change by less than the
    relative EM_TOLERANCE; `steps` = 0 only evaluates.  After every second step it leaps to where the last two lead
    (SQUAREM; Varadhan and Roland 2008), if that is likelier: pushes that poses hardly show it would take hundreds of
    steps to size.  Scales are `most` at most.  `moments` are the segments' products of residuals and derivatives by
    nuisances (`segment_moments`).

    Raises:
        PredictionDiverged: where a prediction or a scale is not finite, or rounding makes a chi^2 negative.
    """
    require_finite("a prediction", moments.rr, moments.AA)
    terms, path = checked_marginal_terms(moments, scales), [scales]
    for _ in range(steps):
        scales = em_update(terms, moments.rows, scales.rho, most)
        require_finite("the noise", scales.r, scales.q)
        terms = terms_within_rounding(moments, scales)
        if np.allclose(as_vector(path[-1]), as_vector(scales), rtol=0.0, atol=EM_TOLERANCE):
            break
        path.append(scales)
        if len(path) > 2 and len(path) % 2 and steps > EM_STEPS_BEFORE_LEAPS:
            scales, terms = _leap(path[-3:], terms, moments, most)
            path = [scales]
    return scales, terms


def _leap(path: Sequence[Scales], terms: MarginalTerms, moments: Moments, most: Scales) -> tuple[Scales, MarginalTerms]:
    """The scales to which two steps of EM along a `path` lead, and the terms there; its end where that is likelier."""
    before, between, end = (as_vector(scales) for scales in path)
    step, bend = between - before, end - 2.0 * between + before
    length = -max(float(np.linalg.norm(step)) / max(float(np.linalg.norm(bend)), 1e-12), 1.0)
    ahead = from_vector(before - 2.0 * length * step + length**2 * bend, most)
    try:
        there = terms_within_rounding(moments, ahead)
    except PredictionDiverged:
        return path[-1], terms
    likelier = student_log_densities(there).sum() > student_log_densities(terms).sum()
    return (ahead, there) if likelier else (path[-1], terms)


def em_update(terms: MarginalTerms, rows: Ints, rho: Floats, most: Scales = UNLIMITED) -> Scales:
    """Scales after one step of expectation maximisation (EM) from likelihood `terms`, where pushes persisted by `rho`.

    `rows` (S,) counts the mean poses of each segment; scales are `most` at most.  Squared residuals and pushes are
    multiplied by the segment's robust weight, posterior variances are not: that would bias the scales, and raise the
    likelihood where nothing is missing.  Variances are divided by the mean weight to converge in fewer steps
    (parameter-expanded EM; Meng and van Dyk 1997).
    """
    w = robust_weights(terms)
    r2 = (w[:, None] * terms.rest + terms.spread).sum(axis=0) / rows.sum()
    pushes = terms.z[:, N_START:].reshape(-1, KNOTS, 3)
    V = terms.V[:, N_START:, N_START:].reshape(-1, KNOTS, 3, KNOTS, 3)
    products = np.einsum("s,sic,sjc->cij", w, pushes, pushes) + np.einsum("sicjc->cij", V)
    products /= len(pushes) * w.mean()
    r2 /= w.mean()
    q2 = np.array([np.sum(autoregressive_precision(rho[c]) * products[c]) / KNOTS for c in range(3)])
    r, q = (np.sqrt(np.maximum(square, MIN_VARIANCE)) for square in (r2, q2))
    rho = np.array([likeliest_persistence(products[c] / q[c] ** 2) for c in range(3)])
    return Scales(np.minimum(r, most.r), np.minimum(q, most.q), rho)

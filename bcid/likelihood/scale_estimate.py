"""The likeliest standard deviations of noise and pushes, by expectation maximisation (EM)."""

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.marginal import (
    MarginalTerms,
    Moments,
    checked_marginal_terms,
    robust_weights,
    terms_within_rounding,
)
from bcid.likelihood.scales import UNLIMITED, Scales
from bcid.likelihood.take import KNOTS, N_START

MIN_VARIANCE = 1e-10  # what is left of a difference of large numbers may be negative
EM_TOLERANCE = 1e-3  # relative change of the scales, and change of correlations, at which EM ends
BISECTIONS = 30  # of the interval in which a correlation is sought


def estimate_scales(
    moments: Moments, scales: Scales, steps: int, most: Scales = UNLIMITED
) -> tuple[Scales, MarginalTerms]:
    """The likeliest scales of noise and pushes, and the segments' marginal likelihood terms there.

    Expectation maximisation (EM) takes at most `steps` from `scales`, and ends where they change by less than the
    relative EM_TOLERANCE, and correlations by EM_TOLERANCE; `steps` = 0 only evaluates.  Scales are `most` at most.
    `moments` are the segments' products of residuals and derivatives by nuisances (`segment_moments`).

    Raises:
        PredictionDiverged: where a prediction or a scale is not finite, or rounding makes a chi^2 negative.
    """
    require_finite("a prediction", moments.rr, moments.AA)
    terms = checked_marginal_terms(moments, scales)
    for _ in range(steps):
        before, scales = scales, em_update(terms, moments.rows, most)
        require_finite("the noise", scales.r, scales.q, scales.rho)
        terms = terms_within_rounding(moments, scales)
        same = np.allclose(np.r_[before.r, before.q], np.r_[scales.r, scales.q], rtol=EM_TOLERANCE, atol=0.0)
        if same and np.allclose(before.rho, scales.rho, rtol=0.0, atol=EM_TOLERANCE):
            break
    return scales, terms


def em_update(terms: MarginalTerms, rows: Ints, most: Scales = UNLIMITED) -> Scales:
    """Standard deviations of noise and pushes after one step of expectation maximisation (EM) from likelihood `terms`.

    `rows` (S,) counts the mean poses of each segment; scales are `most` at most.  Squared residuals and pushes are
    multiplied by the segment's robust weight, posterior variances are not: that would bias the scales, and raise the
    likelihood where nothing is missing.  Variances are divided by the mean weight to converge in fewer steps
    (parameter-expanded EM; Meng and van Dyk 1997).
    """
    w = robust_weights(terms)
    r2 = (w[:, None] * terms.rest + terms.spread).sum(axis=0) / rows.sum()
    pushes = terms.z[:, N_START:].reshape(-1, KNOTS, 3)
    spread = terms.V[:, N_START:, N_START:].reshape(-1, KNOTS, 3, KNOTS, 3)
    products = np.einsum("s,skc,slc->ckl", w, pushes, pushes) + np.einsum("skclc->ckl", spread)
    q2, rho = autoregression(products / len(w), most.rho)
    r, q = (np.sqrt(np.maximum(square / w.mean(), MIN_VARIANCE)) for square in (r2, q2))
    return Scales(np.minimum(r, most.r), np.minimum(q, most.q), rho)


def autoregression(products: Floats, most: Floats) -> tuple[Floats, Floats]:
    """Likeliest variances and correlations (C,) of C autoregressive processes of first order, by their mean products.

    `products` (C, K, K) are means of p_k p_l over stretches of K values.  Let a be the sum of p_k^2, b of p_k p_{k+1},
    and c of p_k^2 but for both ends.  Then -2 log density is K log S + (K - 1) log(1 - rho^2), where S = K q^2 =
    (a - 2 rho b + rho^2 c) / (1 - rho^2).  It is least where

        K (rho c - b) (1 - rho^2) + rho (a - 2 rho b + rho^2 c) = 0.

    Below zero, and beyond `most` (C,), rho is not sought.
    """
    K = products.shape[1]
    square = np.einsum("ckk->ck", products)
    a, b, c = square.sum(axis=1), np.einsum("ckk->ck", products[:, :-1, 1:]).sum(axis=1), square[:, 1:-1].sum(axis=1)
    low, high = np.zeros_like(a), most.copy()
    for _ in range(BISECTIONS):
        rho = 0.5 * (low + high)
        rises = K * (rho * c - b) * (1.0 - rho**2) + rho * (a - 2.0 * rho * b + rho**2 * c) > 0.0
        low, high = np.where(rises, low, rho), np.where(rises, rho, high)
    rho = 0.5 * (low + high)
    return (a - 2.0 * rho * b + rho**2 * c) / ((1.0 - rho**2) * K), rho

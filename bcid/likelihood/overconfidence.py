"""How much the curvature of the likelihood overstates what a take says of a model's parameters.

Of a right model, the slopes g_s of the segments' log-likelihoods scatter as their information H = sum H_s says:
J = sum g_s g_s' is H.  Where the model lacks something, what a segment pulls at a parameter is mostly that, alike in one
segment and the other way in the next: J is larger, and the likelihood counts as evidence what is none.  The parameters
then scatter by H^-1 J H^-1 (Huber 1967; White 1982), and a log-likelihood divided by

    kappa = tr(H^-1 J) / n

has, in the mean over the n parameters, the curvature that their scatter has (Pauli, Racugno and Ventura 2011).
"""

import numpy as np

from bcid.likelihood.projection import linearise_fit
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take

LEAST_INFORMATION = 1e-12
"""Share of the largest information of a parameter, below which a take says nothing of one."""


def overconfidence(fit: Fit, take: Take) -> float:
    """The factor kappa, 1 or more, by which the likelihood of a fit with names overstates what `take` says of them.

    Initial states and pushes of each segment are projected out.  Parameters at a bound, and those of which the take
    says nothing, do not count; a factor below 1 is chance.

    Raises:
        PredictionDiverged: where a prediction or a change of it is not finite.
    """
    at = linearise_fit(fit, take)
    own = np.flatnonzero(at.bends[: fit.hypothesis.named_size])
    H = np.einsum("s,sij->ij", at.weights, at.information)[np.ix_(own, own)]
    scale = np.sqrt(np.diag(H))
    shown = scale > np.sqrt(LEAST_INFORMATION) * scale.max(initial=0.0)
    if not shown.any():
        return 1.0
    per_scale = 1.0 / scale[shown]
    slopes = (at.weights[:, None] * at.slopes)[:, own[shown]] * per_scale
    information = H[np.ix_(shown, shown)] * np.outer(per_scale, per_scale)
    ratios = np.linalg.lstsq(information, slopes.T @ slopes, rcond=LEAST_INFORMATION)[0]
    return max(1.0, float(np.trace(ratios)) / int(shown.sum()))

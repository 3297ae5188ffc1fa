"""What a take alone says of parameters: the information of a fit less that of its prior."""

import numpy as np

from bcid.aliases import Floats

LEAST_INFORMATION = 1e-9  # of a direction beside the best known one: a take shows less of some, and rounding none


def take_away_prior(covariance: Floats, stiffness: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (n,) and eigenvectors (n, n) of a take's information about n parameters.

    It is the inverse of their `covariance` (n, n) at a fit less the `stiffness` (n,) of the prior there.  Eigenvalues
    that are LEAST_INFORMATION of the largest at most are zero.
    """
    information = np.linalg.pinv(covariance, hermitian=True) - np.diag(stiffness)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    return np.where(values > LEAST_INFORMATION * values.max(), values, 0.0), vectors

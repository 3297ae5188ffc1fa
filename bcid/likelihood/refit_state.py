"""A point of a refit and what it is worth: the state that steps of parameters and initial states move.

What predicts or estimates scales raises `PredictionDiverged` where these leave the finite numbers.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import NU, MarginalTerms, segment_moments, student_log_densities
from bcid.likelihood.nuisance import about_no_pushes, pose_residuals, posterior_step
from bcid.likelihood.prior import Prior
from bcid.likelihood.scale_estimate import estimate_scales
from bcid.likelihood.scales import UNLIMITED, Scales
from bcid.likelihood.take import N_START, Take

MIN_GAIN = 0.5  # nats, less than which counts for nothing
EM_STEPS, MAX_EM_STEPS = 2, 20  # on the way along a tangent, and where the scales have to converge


class Tangent(NamedTuple):
    """Derivatives of the predicted poses at a fit."""

    A: Floats  # (N, 3, N_NUISANCE) by the segments' nuisance parameters
    J: Floats  # (N, 3, base_size + K) by the base parameters, and by the remainder's coefficients over their prior sd


class Effort(NamedTuple):
    """How far a refit goes."""

    tangents: int = 24  # linearisations of the predictions
    iterations: int = 12  # steps along each
    least: float = MIN_GAIN  # nats, below which a step has gained nothing


class RefitProblem(NamedTuple):
    """The take, the hypothesis that is fitted to it, the prior of its parameters, and how far a refit goes."""

    take: Take
    hypothesis: Hypothesis
    prior: Prior
    most: Scales = UNLIMITED  # that noise and pushes may be
    effort: Effort = Effort()

    def residuals(self, phi: Floats, start: Floats) -> Floats:
        """Measured less predicted poses (N, 3) at phi, from the nuisance parameters `start` (S, N_NUISANCE)."""
        return pose_residuals(self.take, self.hypothesis.prediction_inputs(phi, self.take), start)

    def objective(self, phi: Floats, terms: MarginalTerms) -> float:
        """Log-likelihood of all segments plus log prior density of phi, less a constant."""
        return float(student_log_densities(terms).sum()) + self.prior.log_density(phi)


class RefitState(NamedTuple):
    """A point of a refit and the likelihood there."""

    phi: Floats
    start: Floats  # (S, N_NUISANCE) initial states and pushes
    scales: Scales
    r: Floats  # (N, 3) residual
    A: Floats  # (N, 3, N_NUISANCE) derivatives of the poses by nuisance parameters, from which the terms come
    terms: MarginalTerms
    objective: float  # log-likelihood plus log prior

    @property
    def worth(self) -> float:
        """Log-likelihood plus log prior (nats), less what initial states have yet to earn."""
        return self.objective - float(promised_nats(self.terms).sum())


def build_state(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, r: Floats, A: Floats, em_steps: int = EM_STEPS
) -> RefitState:
    """The refit's state (with its likelihood) at the parameter vector phi and nuisances `start`, from a known residual.

    `r` (N, 3) is measured less predicted poses, `A` (N, 3, N_NUISANCE) the derivatives of predicted poses by the
    nuisance parameters `start` (initial states and pushes).  The standard deviations of noise and pushes are
    estimated from `scales` by at most `em_steps` of expectation maximisation.
    """
    moments = segment_moments(about_no_pushes(r, A, start, problem.take.first), A, problem.take.first)
    scales, terms = estimate_scales(moments, scales, em_steps, problem.most)
    return RefitState(phi, start, scales, r, A, terms, problem.objective(phi, terms))


def promised_nats(terms: MarginalTerms) -> Floats:
    """Nats (S,) of each segment's likelihood that a step of its initial state promises, and has yet to earn.

    The likelihood takes predictions for linear in the initial state x_0, and integrates over it about the end of the
    step x of least chi^2.  With x_0 held where it is, chi^2 is greater by x^T V_xx^-1 x, V_xx being the posterior
    covariance of x_0.  Where predictions bend before the step's end, so much is promised that no initial state keeps.
    NaN in segments whose prediction is not finite.
    """
    finite = _finite(terms)
    promised = np.full(len(terms.chi2), np.nan)
    # V_xx = R^T R; a part of x_0 that is hardly shown makes V_xx almost singular, and R less so
    R: Floats = np.asarray(np.linalg.qr(terms.root[finite][:, :, :N_START], mode="r"))
    in_sd: Floats = np.asarray(np.linalg.solve(R.transpose(0, 2, 1), terms.z[finite, :N_START, None])[:, :, 0])
    promised[finite] = _lost_beyond(terms, finite, in_sd)
    return promised


def promised_to_all(terms: MarginalTerms, start: Floats) -> Floats:
    """Nats (S,) of each segment's likelihood that a step of its initial state and pushes from `start` promises.

    At `start` (S, N_NUISANCE) itself chi^2 is greater than at the step's end y by y^T M y, where M is the posterior
    precision L L^T.  NaN in segments whose prediction is not finite.
    """
    finite = _finite(terms)
    promised = np.full(len(terms.chi2), np.nan)
    y = posterior_step(start[finite], terms.z[finite])
    in_sd: Floats = np.einsum("sji,sj->si", terms.L[finite], y)
    promised[finite] = _lost_beyond(terms, finite, in_sd)
    return promised


def _finite(terms: MarginalTerms) -> Bools:
    """Which segments (S,) have a finite prediction."""
    return np.asarray(np.isfinite(terms.root).all(axis=(1, 2)) & np.isfinite(terms.z).all(axis=1), dtype=np.bool_)


def _lost_beyond(terms: MarginalTerms, chosen: Bools, in_sd: Floats) -> Floats:
    """Nats that the `chosen` segments lose where their nuisances are `in_sd` standard deviations from the likeliest."""
    chi2 = terms.chi2[chosen]
    half = 0.5 * (NU + terms.numbers[chosen])
    with np.errstate(over="ignore"):  # so far off is as far as can be
        off = chi2 + np.sum(in_sd**2, axis=1)
    return np.asarray(half * (np.log1p(off / NU) - np.log1p(chi2 / NU)))


def segment_worths(terms: MarginalTerms) -> Floats:
    """Log-likelihood (S,) of each segment, less what its initial state has yet to earn (`promised_nats`).

    NaN in segments whose prediction is not finite.
    """
    with np.errstate(invalid="ignore"):
        return student_log_densities(terms) - promised_nats(terms)

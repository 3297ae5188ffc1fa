"""Newton steps on the marginal likelihood: the state of a refit, its tangent there, and where a step leads.

What predicts or estimates scales raises `PredictionDiverged` where these leave the finite numbers.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.likelihood import marginal, nuisance
from bcid.likelihood.hypothesis import GaussianPrior, Hypothesis
from bcid.likelihood.jacobian import base_jacobian, changed_cars, parameter_jacobian
from bcid.likelihood.limits import SEGMENT_LIMITS
from bcid.likelihood.marginal import MarginalTerms, Scales, segment_moments, student_log_densities
from bcid.likelihood.nuisance import move_to_posterior, pose_residuals
from bcid.likelihood.take import Take

MAX_STEP = 3.0  # of any component of phi
EM_STEPS, MAX_EM_STEPS = 2, 20  # on the way along a tangent, and where the scales have to converge
MIN_GAIN = 0.3  # nats, below which a step has gained nothing
RESTART_TANGENTS = 3  # tangents from which a segment that fits badly is tried


class Tangent(NamedTuple):
    """Derivatives of the predicted poses at a fit."""

    A: Floats  # (N, 3, N_NUISANCE) by the segments' nuisance parameters
    J: Floats  # (N, 3, base_size + K) by the base parameters, and by the remainder's coefficients over their prior sd


class RefitProblem(NamedTuple):
    """The take, the hypothesis that is fitted to it, and the prior of its parameters."""

    take: Take
    hypothesis: Hypothesis
    prior: GaussianPrior

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
    J: Floats | None = None  # (N, 3, R + K) by `body_parameters` and the remainder, where it was found with A


def linearise_at(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, em_steps: int = EM_STEPS
) -> tuple[Tangent, RefitState]:
    """Evaluate a refit at the parameter vector phi (`evaluate_at`), and differentiate its predicted poses there.

    The derivatives are by base parameters and by nuisance parameters, the initial states and pushes `start` of
    segments.
    """
    state = evaluate_at(problem, phi, start, scales, em_steps, with_parameters=True)
    return tangent_at(problem, state), state._replace(J=None)


def evaluate_at(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, em_steps: int, with_parameters: bool = False
) -> RefitState:
    """The refit's state (residual, likelihood, nuisances, scales) at the parameter vector phi, which stays fixed.

    `start` (S, N_NUISANCE) stays, except in segments with a high chi^2, which restart from their measured poses.  The
    standard deviations of noise and pushes are estimated from `scales` in at most `em_steps` of expectation
    maximisation.  Derivatives by base parameters can be found in the same run (`with_parameters`).
    """
    take, inputs = problem.take, problem.hypothesis.prediction_inputs(phi, problem.take)
    changed = changed_cars(problem.hypothesis, phi) if with_parameters else None
    r, A, J = nuisance.linearise_residuals(take, inputs, start, changed)
    state = build_state(problem, phi, start.copy(), scales, r, A, em_steps)
    return _restart_misfitting_segments(problem, state._replace(J=J if with_parameters else None), em_steps)


def move_initial_states(problem: RefitProblem, state: RefitState) -> RefitState:
    """The refit's state with segments' initial states moved to their posterior means.

    Residuals are predicted anew, derivatives kept.  Each segment is decided by itself: it stays where it was if its
    log-likelihood falls by SEGMENT_LIMITS.max_loss_nats or more, or is not finite.
    """
    start = move_to_posterior(state.start, state.terms.z)
    r = problem.residuals(state.phi, start)
    terms = _terms_along_tangent(state.A, r, problem.take, state.scales)
    moves = _segment_gains(terms, state.terms) > -SEGMENT_LIMITS.max_loss_nats
    rows, terms = np.repeat(moves, np.diff(problem.take.first)), _select_terms(moves, terms, state.terms)
    start, r = np.where(moves[:, None], start, state.start), np.where(rows[:, None], r, state.r)
    return state._replace(start=start, r=r, terms=terms, objective=problem.objective(state.phi, terms))


def _restart_misfitting_segments(problem: RefitProblem, state: RefitState, em_steps: int) -> RefitState:
    """The refit's state with badly fitting segments restarted from initial states found in their measured poses.

    A segment fits badly if its chi^2 per measured number is SEGMENT_LIMITS.restart_chi2 or more.  From the restart,
    it takes Gauss-Newton steps of its initial state; an end replaces the old one where log-likelihood grows by at
    least SEGMENT_LIMITS.max_loss_nats.  Unchanged if more than SEGMENT_LIMITS.max_restarted_share of the segments fit
    badly.
    """
    take = problem.take
    misfits = np.flatnonzero(~(state.terms.chi2 < SEGMENT_LIMITS.restart_chi2 * state.terms.numbers))
    if not 0 < len(misfits) <= SEGMENT_LIMITS.max_restarted_share * take.segments:
        return state
    part, rows, inputs = take.part(misfits), take.rows(misfits), problem.hypothesis.prediction_inputs(state.phi, take)
    start, all_starts, all_r, all_A = part.start, state.start.copy(), state.r.copy(), state.A.copy()
    all_J, changed = (None, None) if state.J is None else (state.J.copy(), changed_cars(problem.hypothesis, state.phi))
    best = MarginalTerms(*(term[misfits] for term in state.terms))
    for _ in range(RESTART_TANGENTS):
        r, A, J = nuisance.linearise_residuals(part, inputs, start, changed)
        terms = _terms_along_tangent(A, r, part, state.scales)
        better = ~(_segment_gains(terms, best) < SEGMENT_LIMITS.max_loss_nats) & np.isfinite(terms.chi2)
        to, of_part = rows[part.rows(np.flatnonzero(better))], part.rows(np.flatnonzero(better))
        all_starts[misfits[better]], all_r[to], all_A[to] = start[better], r[of_part], A[of_part]
        if all_J is not None:
            all_J[to] = J[of_part]
        best = _select_terms(better, terms, best)
        finite = np.isfinite(terms.z).all(axis=1, keepdims=True)
        start = np.where(finite, move_to_posterior(start, terms.z), start)
    return build_state(problem, state.phi, all_starts, state.scales, all_r, all_A, em_steps)._replace(J=all_J)


def _terms_along_tangent(A: Floats, r: Floats, take: Take, scales: Scales) -> MarginalTerms:
    """Marginal likelihood terms of segments, predictions being linear in initial states and pushes.

    `r` (N, 3) is measured less predicted poses, `A` (N, 3, N_NUISANCE) are the derivatives of predicted ones.  The
    terms (chi^2, log-determinant, posterior) are NaN in segments whose prediction is not finite.
    """
    moments = segment_moments(r, A, take.first)
    return marginal.eliminate_nuisance(moments, scales.r, scales.nuisance_precisions())


def _segment_gains(new: MarginalTerms, old: MarginalTerms) -> Floats:
    """Log-likelihood gain (S,) in nats of each segment from `old` to `new` terms; NaN where either has diverged."""
    with np.errstate(invalid="ignore"):
        return student_log_densities(new) - student_log_densities(old)


def _select_terms(mask: Bools, first: MarginalTerms, second: MarginalTerms) -> MarginalTerms:
    """Marginal likelihood terms from `first` in segments where `mask` (S,) is True, from `second` in the others."""
    pairs = zip(first, second, strict=True)
    return MarginalTerms(*(np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs))


def tangent_at(problem: RefitProblem, state: RefitState) -> Tangent:
    """Linearisation of the predicted poses at a refit's `state`: their derivatives by nuisance and by base parameters.

    Those by nuisance parameters (each segment's initial state and pushes) are `state.A`.
    """
    return Tangent(state.A, base_jacobian(problem.take, problem.hypothesis, state.phi, state.start, state.r, state.J))


def build_state(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, r: Floats, A: Floats, em_steps: int = EM_STEPS
) -> RefitState:
    """The refit's state (with its likelihood) at the parameter vector phi and nuisances `start`, from a known residual.

    `r` (N, 3) is measured less predicted poses, `A` (N, 3, N_NUISANCE) the derivatives of predicted poses by the
    nuisance parameters `start` (initial states and pushes).  The standard deviations of noise and pushes are
    estimated from `scales` by at most `em_steps` of expectation maximisation.
    """
    moments = segment_moments(r, A, problem.take.first)
    scales, terms = marginal.estimate_scales(moments, scales, em_steps)
    return RefitState(phi, start, scales, r, A, terms, problem.objective(phi, terms))


def slope_and_curvature(problem: RefitProblem, tangent: Tangent, state: RefitState) -> tuple[Floats, Floats]:
    """Gradient (n,) and Gauss-Newton curvature (n, n), about -Hessian, of log-likelihood plus log prior by phi.

    phi is the parameter vector (log base parameters, drag, effects' parameters).  Derivatives of predicted poses by
    base parameters are those of `tangent`; those by effects' parameters are computed at `state` by finite
    differences.
    """
    take, hypothesis, prior = problem
    own = range(hypothesis.base_size, hypothesis.named_size)
    effects = parameter_jacobian(take, hypothesis, state.phi, state.start, state.r, own)
    base, functions = np.split(tangent.J, [hypothesis.base_size], axis=2)
    J = np.concatenate([base, effects, functions], axis=2)
    g, G = marginal.score_and_information(state.r, state.A, J, take.first, state.scales.r, state.terms.root)
    w = marginal.robust_weights(state.terms)
    slope = w @ g - prior.stiffness * (state.phi - prior.centre)
    return slope, np.tensordot(w, G, axes=1) + np.diag(prior.stiffness)


def bounded_newton_step(phi: Floats, slope: Floats, curvature: Floats, bounds: tuple[Floats, Floats]) -> Floats:
    """Parameter vector phi + curvature^-1 slope after a Newton step within `bounds` (low, high), by an active set.

    Components that reach a bound, or whose two bounds are equal, are fixed, and the step is solved again for the
    others; no component changes by more than MAX_STEP.
    """
    low, high = bounds
    free, after = low < high, phi.copy()
    while free.any():
        rest = slope - curvature[:, ~free] @ (after - phi)[~free]
        change = np.linalg.lstsq(curvature[np.ix_(free, free)], rest[free], rcond=None)[0]
        after[free] = phi[free] + np.clip(change, -MAX_STEP, MAX_STEP)
        outside = free & ((after < low) | (after > high))
        if not outside.any():
            break
        after[outside] = np.clip(after, low, high)[outside]
        free &= ~outside
    return after

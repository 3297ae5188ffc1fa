"""Newton steps on the marginal likelihood: the state of a refit, its tangent there, and where a step leads.

What predicts or estimates scales raises `PredictionDiverged` where these leave the finite numbers.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.likelihood import marginal, nuisance
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.hypothesis import GaussianPrior, Hypothesis
from bcid.likelihood.marginal import MarginalTerms, Scales, segment_moments, student_log_densities
from bcid.likelihood.nuisance import move_to_posterior, pose_residuals, remove_pushes
from bcid.likelihood.predict import wrap_yaw
from bcid.likelihood.take import Take

# difference steps of base parameters, and of effects in units of their size: some have kinks that a smaller step misses
BASE_STEP, EFFECT_STEP = 1e-3, 0.05
MAX_STEP = 3.0  # of any component of phi
EM_STEPS, MAX_EM_STEPS = 2, 20  # on the way along a tangent, and where the scales have to converge
MIN_GAIN = 0.3  # nats, below which a step has gained nothing
RESTART_CHI2 = 4.0  # chi^2 for each number measured (about 1 is expected) from which a segment begins anew
MAX_RESTARTED_SHARE = 0.1  # of the segments, beyond which it is the parameters' fault
RESTART_TANGENTS = 3  # tangents from which a segment that fits badly is tried
MAX_SEGMENT_LOSS = 3.0  # nats that a segment may lose by a step of its own before its tangent has misled it


class Tangent(NamedTuple):
    """Derivatives of the predicted poses at a fit."""

    A: Floats  # (N, 3, N_NUISANCE) by the segments' nuisance parameters
    J: Floats  # (N, 3, base_size) by the base parameters


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


def parameter_jacobian(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, r: Floats, components: range
) -> Floats:
    """Derivatives (N, 3, n) of the poses predicted from `start` by n `components` of phi.

    They are differences from the residual `r` (N, 3) at phi, and may reach beyond a trusted simulation's bounds: a step
    back from there could meet an effect that is off.
    """
    _, high = hypothesis.plausible_bounds()
    columns = []
    for j in components:
        width = BASE_STEP if j < hypothesis.base_size else EFFECT_STEP
        moved = phi.copy()
        moved[j] += width if phi[j] + width <= high[j] else -width
        there = pose_residuals(take, hypothesis.prediction_inputs(moved, take), start)
        columns.append(wrap_yaw(r - there) / (moved[j] - phi[j]))
        require_finite("a prediction", columns[-1])  # LAPACK would not come back from it
    return np.stack(columns, axis=2) if columns else np.zeros((*r.shape, 0))


def linearise_at(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, em_steps: int = EM_STEPS
) -> tuple[Tangent, RefitState]:
    """The tangent of predictions at the parameters phi, and the refit's state there by `evaluate_at`."""
    state = evaluate_at(problem, phi, start, scales, em_steps)
    return tangent_at(problem, state), state


def evaluate_at(problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, em_steps: int) -> RefitState:
    """The refit's state at phi: nuisance parameters solved from `start`, scales after `em_steps` from `scales`."""
    take = problem.take
    start, r, A = nuisance.solve_nuisance(take, problem.hypothesis.prediction_inputs(phi, take), start, scales)
    state = build_state(problem, phi, start, scales, r, A, em_steps)
    return with_actual_misfit(problem, state) if take.pushed else _restart_misfitting_segments(problem, state, em_steps)


def move_initial_states(problem: RefitProblem, state: RefitState) -> RefitState:
    """The refit's state with initial states at their posterior mean, save in segments that lose over MAX_SEGMENT_LOSS.

    Each segment is decided by itself: one of four hundred whose prediction a kink upsets would hold back all others.
    Those that lose little are moved too: of two tangents the likelier one errs in its own favour.
    """
    start = move_to_posterior(problem.take, state.start, state.terms.z)
    r = problem.residuals(state.phi, start)
    terms = _terms_along_tangent(state.A, start, r, problem.take, state.scales)
    moves = _segment_gains(terms, state.terms) > -MAX_SEGMENT_LOSS
    rows, terms = np.repeat(moves, np.diff(problem.take.first)), _select_terms(moves, terms, state.terms)
    start, r = np.where(moves[:, None], start, state.start), np.where(rows[:, None], r, state.r)
    return state._replace(start=start, r=r, terms=terms, objective=problem.objective(state.phi, terms))


def _restart_misfitting_segments(problem: RefitProblem, state: RefitState, em_steps: int) -> RefitState:
    """The refit's state with badly fitting segments begun anew from their recorded initial states, if much likelier.

    Once a segment's initial state is far off, its tangent leads nowhere.
    """
    take = problem.take
    misfits = np.flatnonzero(~(state.terms.chi2 < RESTART_CHI2 * state.terms.numbers))
    if not 0 < len(misfits) <= MAX_RESTARTED_SHARE * take.segments:
        return state
    part, rows, inputs = take.part(misfits), take.rows(misfits), problem.hypothesis.prediction_inputs(state.phi, take)
    start, all_starts, all_r, all_A = part.start, state.start.copy(), state.r.copy(), state.A.copy()
    best = MarginalTerms(*(term[misfits] for term in state.terms))
    for _ in range(RESTART_TANGENTS):
        r, A = pose_residuals(part, inputs, start), nuisance.nuisance_sensitivities(part, inputs, start)
        terms = _terms_along_tangent(A, start, r, part, state.scales)
        better = ~(_segment_gains(terms, best) < MAX_SEGMENT_LOSS) & np.isfinite(terms.chi2)
        to, of_part = rows[part.rows(np.flatnonzero(better))], part.rows(np.flatnonzero(better))
        all_starts[misfits[better]], all_r[to], all_A[to] = start[better], r[of_part], A[of_part]
        best = _select_terms(better, terms, best)
        finite = np.isfinite(terms.z).all(axis=1, keepdims=True)
        start = np.where(finite, move_to_posterior(part, start, terms.z), start)
    return build_state(problem, state.phi, all_starts, state.scales, all_r, all_A, em_steps)


def _terms_along_tangent(A: Floats, start: Floats, r: Floats, take: Take, scales: Scales) -> MarginalTerms:
    """Likelihood terms of the residual `r` with the tangent `A`; NaN in segments whose predictions have diverged."""
    moments = segment_moments(remove_pushes(r, A, start, take.first), A, take.first)
    return marginal.eliminate_nuisance(moments, scales.r, scales.nuisance_precisions())


def _segment_gains(new: MarginalTerms, old: MarginalTerms) -> Floats:
    """Nats (S,) that each segment gains from `old` to `new` terms; NaN where either has diverged."""
    with np.errstate(invalid="ignore"):
        return student_log_densities(new) - student_log_densities(old)


def _select_terms(mask: Bools, first: MarginalTerms, second: MarginalTerms) -> MarginalTerms:
    """The terms of `first` in the segments of the `mask` (S,), of `second` in the others."""
    pairs = zip(first, second, strict=True)
    return MarginalTerms(*(np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs))


def tangent_at(problem: RefitProblem, state: RefitState) -> Tangent:
    """Derivatives of the predicted poses at `state`, by nuisance parameters and by base parameters."""
    hypothesis, base = problem.hypothesis, range(problem.hypothesis.base_size)
    return Tangent(state.A, parameter_jacobian(problem.take, hypothesis, state.phi, state.start, state.r, base))


def build_state(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, r: Floats, A: Floats, em_steps: int = EM_STEPS
) -> RefitState:
    """The refit's state at phi and `start`, from residual `r` and derivatives `A`; scales after `em_steps` of EM."""
    first = problem.take.first
    moments = segment_moments(remove_pushes(r, A, start, first), A, first)
    scales, terms = marginal.estimate_scales(moments, scales, em_steps)
    return RefitState(phi, start, scales, r, A, terms, problem.objective(phi, terms))


def with_actual_misfit(problem: RefitProblem, state: RefitState) -> RefitState:
    """The refit's state with each segment's chi^2 as residual and pushes make it; unchanged unless `take.pushed`.

    The tangent promises a chi^2 that a segment whose nuisance parameters converge slowly has not reached.
    """
    if not problem.take.pushed:
        return state
    terms = state.terms._replace(chi2=nuisance.segment_misfit(problem.take, state.start, state.r, state.scales))
    return state._replace(terms=terms, objective=problem.objective(state.phi, terms))


def slope_and_curvature(problem: RefitProblem, tangent: Tangent, state: RefitState) -> tuple[Floats, Floats]:
    """Slope (n,) and Gauss-Newton curvature (n, n) of the objective by phi; effects' columns computed at `state`."""
    (take, hypothesis, prior), first = problem, problem.take.first
    own = range(hypothesis.base_size, hypothesis.size)
    effects = parameter_jacobian(take, hypothesis, state.phi, state.start, state.r, own)
    J = np.concatenate([tangent.J, effects], axis=2)
    r = remove_pushes(state.r, state.A, state.start, first)
    g, G = marginal.score_and_information(r, state.A, J, first, state.scales.r, state.terms.V)
    w = marginal.robust_weights(state.terms)
    slope = w @ g - prior.stiffness * (state.phi - prior.centre)
    return slope, np.tensordot(w, G, axes=1) + np.diag(prior.stiffness)


def bounded_newton_step(phi: Floats, slope: Floats, curvature: Floats, bounds: tuple[Floats, Floats]) -> Floats:
    """Parameters phi after a Newton step within `bounds`, by an active set: those that reach a bound stay there.

    The step of the others is solved for again with these, and all whose bounds leave no room, held fixed.
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

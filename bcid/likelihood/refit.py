"""The joint refit of base parameters and effects: Gauss-Newton on the marginal likelihood, robust over segments.

All functions raise `PredictionDiverged` where predictions at their starting point leave the finite numbers.
"""

from dataclasses import dataclass

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood import newton
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.hypothesis import GaussianPrior, Hypothesis
from bcid.likelihood.marginal import Scales, student_log_densities
from bcid.likelihood.newton import MAX_EM_STEPS, RefitProblem, RefitState, Tangent, build_state, linearise_at
from bcid.likelihood.nuisance import move_to_posterior, solve_nuisance
from bcid.likelihood.refit_with_pushes import refit_by_leaps
from bcid.likelihood.take import Take
from bcid.physics.car import Car

MAX_ITERATIONS = 12  # along one tangent
MAX_TANGENTS = 24
STEP_SHARES = (1.0, 0.3, 0.1, 0.03)  # of a step, where the whole of it leads astray
PHI_DAMPINGS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)
"""Added to the curvature by phi, whose components are of size one: what the take hardly shows is held back, and valleys
that logarithms of two parameters share stay open (scaled by the curvature's diagonal they would be closed)."""
FAR = 0.03  # a step of phi after which the tangent is found anew: 3 % of a base parameter
FIXED_ROUNDS = 3  # in which initial states converge where phi is fixed


@dataclass(frozen=True)
class Fit:
    """A hypothesis fitted to a take of S segments and N rows."""

    hypothesis: Hypothesis
    phi: Floats
    start: Floats  # (S, N_NUISANCE) initial states, and pushes where predictions are made under them
    scales: Scales
    log_likelihood: float  # sum over segments, without the prior
    per_segment: Floats  # (S,)
    covariance: Floats  # of phi
    tangent: Tangent

    @property
    def penalised_log_likelihood(self) -> float:
        """Log-likelihood plus log prior, less log(S)/2 for each effect parameter (nats): more is better."""
        extra = len(self.hypothesis.effect_parameters)
        return self.log_likelihood + self.log_prior - 0.5 * extra * float(np.log(len(self.per_segment)))

    @property
    def log_prior(self) -> float:
        """Log prior density of phi under a trusted simulation, less its maximum (nats, at most 0); 0 without one."""
        trusted = self.hypothesis.trusted_simulation is not None
        return self.hypothesis.prior(self.phi).log_density(self.phi) if trusted else 0.0

    def car(self) -> Car:
        """The car with the fitted base parameters."""
        return self.hypothesis.car(self.phi)

    def effect_estimates(self) -> dict[str, tuple[float, float]]:
        """Value and standard error (SI) of each effect parameter, by its field among the switches."""
        first = self.hypothesis.base_size
        se = np.sqrt(np.maximum(np.diag(self.covariance)[first:], 0.0)) * self.hypothesis.effect_units()
        return {f: (v, float(s)) for (f, v), s in zip(self.hypothesis.effect_values(self.phi).items(), se, strict=True)}


def refit(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales, iterations: int = MAX_ITERATIONS,
    tangent: Tangent | None = None, tangents: int = MAX_TANGENTS,
) -> Fit:  # fmt: skip
    """The fit of likeliest parameters near `phi`, with nuisance parameters from `start` (S, N_NUISANCE) and scales.

    A refit takes at most so many `iterations` along each of at most so many `tangents`, or so many leaps under pushes.
    With a neighbouring fit's `tangent`, that stands throughout, and only the effects' own columns are computed anew: a
    tenth of the work, good enough to compare candidates, though parameters far from the neighbour come out biased.
    """
    phi = np.clip(phi, *hypothesis.bounds())
    problem = RefitProblem(take, hypothesis, hypothesis.prior(phi))
    if tangent is not None:
        state = build_state(problem, phi, start, scales, problem.residuals(phi, start), tangent.A)
        last, state = tangent, _descend_along_tangent(problem, tangent, state, iterations, np.inf)
    elif take.pushed:
        last, state = refit_by_leaps(problem, phi, start, scales, tangents)
    else:
        last, state = _refit_by_tangents(problem, phi, start, scales, iterations, tangents)
    state = build_state(problem, state.phi, state.start, state.scales, state.r, last.A, MAX_EM_STEPS)
    if tangent is None:
        state = newton.with_actual_misfit(problem, state)
    _, curvature = newton.slope_and_curvature(problem, last, state)
    return _build_fit(hypothesis, last, state, np.asarray(np.linalg.pinv(curvature), dtype=float))


def _build_fit(hypothesis: Hypothesis, tangent: Tangent, state: RefitState, covariance: Floats) -> Fit:
    """The fit of `hypothesis` with the parameters and the likelihood of `state`."""
    each = student_log_densities(state.terms)
    return Fit(hypothesis, state.phi, state.start, state.scales, float(each.sum()), each, covariance, tangent)


def _refit_by_tangents(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, iterations: int, tangents: int
) -> tuple[Tangent, RefitState]:
    """Tangent and state of the best point of a refit along at most `tangents` tangents, each where the last one led."""
    tangent, state = best = linearise_at(problem, phi, start, scales)
    for _ in range(tangents):
        ahead = _descend_along_tangent(problem, tangent, state, iterations, FAR)
        if ahead.objective - state.objective < newton.MIN_GAIN:
            state = ahead
            break
        fresh = _relinearise_ahead(problem, state, ahead)
        if fresh is None:
            break
        tangent, state = fresh
        if state.objective > best[1].objective:
            best = fresh
    return best if best[1].objective > state.objective else (tangent, state)


def _descend_along_tangent(
    problem: RefitProblem, tangent: Tangent, state: RefitState, iterations: int, far: float
) -> RefitState:
    """The state after Gauss-Newton steps along one tangent, until none helps or one changes phi by more than `far`."""
    for _ in range(iterations):
        slope, curvature = newton.slope_and_curvature(problem, tangent, state)
        before, state = state, _step_parameters(problem, state, slope, curvature)
        if state.objective - before.objective < newton.MIN_GAIN or np.max(np.abs(state.phi - before.phi)) > far:
            break
    return state


def _relinearise_ahead(
    problem: RefitProblem, anchor: RefitState, ahead: RefitState
) -> tuple[Tangent, RefitState] | None:
    """The tangent and state at `ahead`, or on the way to it, where they are likelier than `anchor`; None if nowhere.

    Far from where it was computed a tangent promises what is not there, of initial states above all.  Where an edge on
    the floor makes the likelihood rough, a state that is less likely is accepted too.
    """
    rough = problem.hypothesis.is_place.any()
    for share in STEP_SHARES:
        phi = ahead.phi if share == 1.0 else anchor.phi + share * (ahead.phi - anchor.phi)
        start = anchor.start + share * (ahead.start - anchor.start)
        scales = ahead.scales if share == 1.0 else anchor.scales  # less noise suits what is ahead
        fresh = none_if_diverged(linearise_at, problem, phi, start, scales)
        if fresh and (rough or fresh[1].objective > anchor.objective):
            return fresh
    return None


def _step_parameters(problem: RefitProblem, state: RefitState, slope: Floats, curvature: Floats) -> RefitState:
    """The state after the first damped step of phi that raises the objective; `state` itself if none does."""
    bounds = problem.hypothesis.bounds()
    for damping in PHI_DAMPINGS:
        phi = newton.bounded_newton_step(state.phi, slope, curvature + damping * np.eye(len(curvature)), bounds)
        r = problem.residuals(phi, state.start)
        trial = none_if_diverged(build_state, problem, phi, state.start, state.scales, r, state.A)
        if trial and trial.objective > state.objective:
            moved = newton.move_initial_states(problem, trial)
            return moved if moved.objective > state.objective else trial
    return state


def segment_log_likelihoods(take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales) -> Floats:
    """Log-likelihood (S,) of every segment at a fixed phi; nuisance parameters and scales start from those given."""
    phi = np.clip(phi, *hypothesis.bounds())
    problem = RefitProblem(take, hypothesis, GaussianPrior(phi, np.zeros_like(phi)))
    return student_log_densities(newton.evaluate_at(problem, phi, start, scales, MAX_EM_STEPS).terms)


def evaluate_fixed(take: Take, hypothesis: Hypothesis, phi: Floats, scales: Scales) -> Fit:
    """The fit whose parameters phi stay as they are: only nuisance parameters and scales are estimated."""
    problem = RefitProblem(take, hypothesis, GaussianPrior(phi, np.zeros_like(phi)))
    start, inputs = take.start, hypothesis.prediction_inputs(phi, take)
    for _ in range(FIXED_ROUNDS):
        start, r, A = solve_nuisance(take, inputs, start, scales)
        state = build_state(problem, phi, start, scales, r, A, MAX_EM_STEPS)
        start, scales = start if take.pushed else move_to_posterior(take, start, state.terms.z), state.scales
    tangent, state = linearise_at(problem, phi, start, scales, MAX_EM_STEPS)
    return _build_fit(hypothesis, tangent, state, np.zeros((hypothesis.size, hypothesis.size)))

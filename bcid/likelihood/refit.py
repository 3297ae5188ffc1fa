"""The joint refit of base parameters and effects: Gauss-Newton on the marginal likelihood, robust over segments.

All functions raise `PredictionDiverged` where predictions at their starting point leave the finite numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood import newton
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.following import answer_parameters, follow_parameters, move_initial_states
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.kept_fits import kept_in_proofs
from bcid.likelihood.nuisance import about_no_pushes, pose_residuals
from bcid.likelihood.price import price_nats
from bcid.likelihood.prior import Prior
from bcid.likelihood.refit_state import (
    MAX_EM_STEPS,
    Effort,
    RefitProblem,
    RefitState,
    Tangent,
    build_state,
    segment_worths,
)
from bcid.likelihood.scales import UNLIMITED, Scales
from bcid.likelihood.take import Take
from bcid.physics.car import Car

STEP_SHARES = (1.0, 0.3, 0.1, 0.03)  # of a step, where the whole of it leads astray
PHI_DAMPINGS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)
"""Added to the curvature by phi, whose components are of size one: what the take hardly shows is held back, and valleys
that logarithms of two parameters share stay open (scaled by the curvature's diagonal they would be closed)."""
THOROUGH = Effort()
SETTLING_ROUNDS = 3  # of evaluations at fixed parameters
FAR = 0.03  # a step of phi after which the tangent is found anew: 3 % of a base parameter


@dataclass(frozen=True)
class Fit:
    """A hypothesis fitted to a take of S segments and N rows."""

    hypothesis: Hypothesis
    phi: Floats
    start: Floats  # (S, N_NUISANCE) initial states and pushes, about which predictions are linear
    scales: Scales
    log_likelihood: float  # sum over segments, without the prior
    per_segment: Floats  # (S,)
    covariance: Floats  # of phi
    tangent: Tangent

    @property
    def penalised_log_likelihood(self) -> float:
        """Log-likelihood plus log prior, less log(S)/2 for each effect parameter (nats): more is better."""
        price = price_nats(len(self.hypothesis.effect_parameters), len(self.per_segment))
        return self.log_likelihood + self.log_prior - price

    @property
    def log_prior(self) -> float:
        """Log prior density of phi under a trusted simulation, less its maximum (nats, at most 0); 0 without one."""
        trusted = self.hypothesis.trusted_simulation is not None
        return self.hypothesis.prior(self.phi).log_density(self.phi) if trusted else 0.0

    def car(self) -> Car:
        """The car with the fitted base parameters."""
        return self.hypothesis.car(self.phi)

    def part(self, take: Take, chosen: Ints) -> tuple[Fit, Take]:
        """The fit and its `take` with the segments of the indices `chosen` only; what is of the whole stays so."""
        rows = take.rows(chosen)
        A, J = (np.ascontiguousarray(derivatives[rows]) for derivatives in self.tangent)
        return replace(self, start=self.start[chosen], tangent=Tangent(A, J)), take.part(chosen)

    def residuals(self, take: Take, phi: Floats) -> Floats:
        """Measured less predicted poses (N, 3) of the fit's `take` at the parameter vector `phi`, pushes from zero.

        Initial states, and the derivatives by which pushes are taken off, are the fit's own.
        """
        r = pose_residuals(take, self.hypothesis.prediction_inputs(phi, take), self.start)
        return about_no_pushes(r, self.tangent.A, self.start, take.first)

    def effect_estimates(self) -> dict[str, tuple[float, float]]:
        """Value and standard error (SI) of each effect parameter, by its field among the switches."""
        own = slice(self.hypothesis.base_size, self.hypothesis.named_size)
        se = np.sqrt(np.maximum(np.diag(self.covariance)[own], 0.0)) * self.hypothesis.effect_units()
        return {f: (v, float(s)) for (f, v), s in zip(self.hypothesis.effect_values(self.phi).items(), se, strict=True)}


@kept_in_proofs
def refit(
    take: Take, hypothesis: Hypothesis, phi: Floats, start: Floats, scales: Scales, effort: Effort = THOROUGH,
    tangent: Tangent | None = None, most: Scales = UNLIMITED, ahead: Sequence[Floats] = (),
) -> Fit:  # fmt: skip
    """The fit of greatest log-likelihood plus log prior near the parameter vector `phi`, by bounded Gauss-Newton.

    phi holds log base parameters, drag and effects' parameters.  Each segment's initial state and pushes (disturbances
    over 0.25 s), from `start` (S, N_NUISANCE), and the standard deviations of noise and pushes, from `scales`, are
    estimated too.  Scales are `most` at most.  The first step leads from phi to the likeliest of the parameter vectors
    `ahead`, or part of the way to it, if that is likelier than phi.  A `tangent` (linearisation at a neighbouring fit),
    if given, is held fixed, and only derivatives by effects are recomputed: a tenth of the work, accurate enough to
    rank candidates, but biased far from that fit.
    """
    phi = np.clip(phi, *hypothesis.bounds())
    problem = RefitProblem(take, hypothesis, hypothesis.prior(phi), most, effort)
    if tangent is not None:
        state = build_state(problem, phi, start, scales, problem.residuals(phi, start), tangent.A)
        last, state = tangent, _descend_along_tangent(problem, tangent, state, None, np.inf)
    else:
        state = newton.evaluate_at(problem, phi, start, scales)
        steps = [_evaluate_ahead(problem, state, state._replace(phi=np.clip(p, *hypothesis.bounds()))) for p in ahead]
        state = max((state, *(s for s in steps if s)), key=lambda s: s.worth)
        last, state = _refit_by_tangents(problem, state)
    state = build_state(problem, state.phi, state.start, state.scales, state.r, last.A, MAX_EM_STEPS)
    _, curvature = newton.slope_and_curvature(problem, state, newton.derivatives_at(problem, last, state))
    return _build_fit(hypothesis, last, state, np.asarray(np.linalg.pinv(curvature), dtype=float))


def _build_fit(hypothesis: Hypothesis, tangent: Tangent, state: RefitState, covariance: Floats) -> Fit:
    """Assemble a `Fit` from a refit's final `state`, its linearisation `tangent` and the `covariance` (n, n) of phi."""
    each = segment_worths(state.terms)
    return Fit(hypothesis, state.phi, state.start, state.scales, float(each.sum()), each, covariance, tangent)


def _refit_by_tangents(problem: RefitProblem, state: RefitState) -> tuple[Tangent, RefitState]:
    """Linearisation and state of greatest log-likelihood plus log prior in a refit.

    Alternates Gauss-Newton steps of phi, with the linearisation of the predictions held fixed, and a new linearisation
    where they led, until this gains less than the least that counts.  On the way over the edge of a place on the floor
    it may lose; what is returned is the likeliest that was met.
    """
    effort, tangent = problem.effort, newton.tangent_at(problem, state)
    best, rough = (tangent, state), problem.hypothesis.is_place.any()
    for _ in range(effort.tangents):
        J = None if rough else none_if_diverged(newton.derivatives_at, problem, tangent, state)
        ahead = _descend_along_tangent(problem, tangent, state, J, FAR)
        if ahead is state or ahead.objective - state.worth < effort.least:
            break
        better = _evaluate_ahead(problem, state, ahead)
        if better is None:
            break
        before, state, tangent = state, better, newton.tangent_at(problem, better)
        best = (tangent, state) if state.worth > best[1].worth else best
        if state.worth - before.worth < effort.least:
            break
    return best


def _descend_along_tangent(
    problem: RefitProblem, tangent: Tangent, state: RefitState, J: Floats | None, far: float
) -> RefitState:
    """The refit's state after some Gauss-Newton steps of phi, the linearisation `tangent` held fixed.

    It stops after the first step that gains less than the least that counts, or that changes a component of phi by more
    than `far`; that step is kept.  Derivatives by effects' parameters are those in `J` (N, 3, n).  Without it they are
    computed at every step, as is needed where the tangent is of a fit without the effect, or the likelihood has edges.
    """
    for _ in range(problem.effort.iterations):
        slopes = none_if_diverged(_slope_along, problem, tangent, state, J)
        if slopes is None:
            break
        before, state = state, _step_parameters(problem, state, slopes)
        if state.objective - before.objective < problem.effort.least or np.max(np.abs(state.phi - before.phi)) > far:
            break
    return state


class Slopes(NamedTuple):
    """How a refit's initial states and pushes, and its likelihood, change with phi at a state."""

    answers: Floats  # (S, N_NUISANCE, n) of the likeliest initial states and pushes
    slope: Floats  # (n,) of log-likelihood plus log prior
    curvature: Floats  # (n, n) about its negative Hessian


def _slope_along(problem: RefitProblem, tangent: Tangent, state: RefitState, J: Floats | None) -> Slopes:
    """Slopes by phi along a `tangent` at a `state`, with derivatives `J` of the poses, or without it those there."""
    J = newton.derivatives_at(problem, tangent, state) if J is None else J
    return Slopes(answer_parameters(problem, state, J), *newton.slope_and_curvature(problem, state, J))


def _evaluate_ahead(problem: RefitProblem, anchor: RefitState, ahead: RefitState) -> RefitState | None:
    """The refit's state at `ahead`, or part of the way from `anchor` to it, with predictions differentiated there.

    The first share of the way in STEP_SHARES at which log-likelihood plus log prior exceeds that of `anchor` is taken
    (backtracking line search); for an effect at a place on the floor, whose edge makes the likelihood rough, the first
    that does not diverge.  None if there is no such share.
    """
    rough = problem.hypothesis.is_place.any()
    for share in STEP_SHARES:
        phi = ahead.phi if share == 1.0 else anchor.phi + share * (ahead.phi - anchor.phi)
        start = anchor.start + share * (ahead.start - anchor.start)
        scales = ahead.scales if share == 1.0 else anchor.scales  # less noise suits what is ahead
        there = none_if_diverged(newton.evaluate_at, problem, phi, start, scales)
        if there and (rough or there.worth > anchor.worth):
            return there
    return None


def _step_parameters(problem: RefitProblem, state: RefitState, at: Slopes) -> RefitState:
    """The refit's state after a damped Newton step of phi, with the least of PHI_DAMPINGS that raises the objective.

    The objective is log-likelihood plus log prior.  Afterwards initial states move to their posterior means, if the
    objective then still exceeds that of `state`.  `state` itself is returned if no damping raises it.
    """
    bounds = problem.hypothesis.bounds()
    for damping in PHI_DAMPINGS:
        phi = newton.bounded_newton_step(state.phi, at.slope, at.curvature + damping * np.eye(len(at.slope)), bounds)
        trial = none_if_diverged(_state_along_tangent, problem, phi, state, at.answers)
        if trial and trial.objective > state.objective:
            moved = move_initial_states(problem, trial)
            return moved if moved.objective > state.objective else trial
    return state


def _state_along_tangent(problem: RefitProblem, phi: Floats, state: RefitState, answers: Floats) -> RefitState:
    """The refit's state at another parameter vector phi, with residuals predicted anew, derivatives those of `state`.

    Initial states and pushes go along with phi, by `answers` (S, N_NUISANCE, n) to a unit of it.  Noise and push scales
    are re-estimated from those of `state`.
    """
    start, r = follow_parameters(problem, state, phi, answers)
    return build_state(problem, phi, start, state.scales, r, state.A)


def evaluate_fixed(take: Take, hypothesis: Hypothesis, phi: Floats, scales: Scales) -> Fit:
    """A fit whose parameter vector is the given phi: only initial states, pushes and standard deviations are estimated.

    Pushes are disturbances, constant over 0.25 s; `scales` (noise and pushes) is the start.  The covariance of phi is
    zero.
    """
    problem = RefitProblem(take, hypothesis, Prior.normal(phi, np.zeros_like(phi)))
    state = newton.evaluate_at(problem, phi, take.start, scales, MAX_EM_STEPS)
    for _ in range(SETTLING_ROUNDS):  # pushes depend on their standard deviation, and it on them
        state = newton.evaluate_at(problem, phi, state.start, state.scales, MAX_EM_STEPS)
    return _build_fit(
        hypothesis, newton.tangent_at(problem, state), state, np.zeros((hypothesis.size, hypothesis.size))
    )

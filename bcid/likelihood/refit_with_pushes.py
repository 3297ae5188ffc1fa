"""The refit of predictions under pushes: every step of phi is judged after the pushes have been solved for again.

Pushes that do the work of what is missing make a tangent hold for a short way only, and a valley of the likelihood runs
straight for long: what a force lacks goes over into the effect that it is, push by push.  So a Newton step is judged
where the nuisance parameters have converged (`bcid.likelihood.nuisance`), and one that goes on as the last one did is
stretched.  The scales are found with them, in turn: pushes found while large ones were likely are unlikely where they
have become rare, so that a step to what is missing would seem a loss, and a refit would stop short of its best.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood import newton
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.marginal import Scales
from bcid.likelihood.newton import MAX_EM_STEPS, MIN_GAIN, RefitProblem, RefitState, Tangent

LEAP_DAMPINGS = (0.0, 10.0, 1e3)  # added to the curvature by phi, whose components are of size one
MIN_LEAP = 1e-4  # of any component of phi
STRAIGHT_COSINE = 0.9  # between steps of which the second goes on as the first did
SLACK = 3.0  # nats by which solving again makes the same parameters better or worse
PATIENCE = 3  # leaps without a gain


class _LinearisedState(NamedTuple):
    """A state with its tangent, and the slope and curvature of the objective there."""

    tangent: Tangent
    state: RefitState
    slope: Floats
    curvature: Floats


def refit_by_leaps(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, leaps: int
) -> tuple[Tangent, RefitState]:
    """Linearisation and state of greatest log-likelihood plus log prior in a refit whose predictions include pushes.

    Pushes are disturbance accelerations, constant over 0.5 s.  From the parameter vector phi, at most `leaps` damped
    Newton steps of phi are taken; after each, segments' initial states and pushes are optimised again.  A step in
    nearly the direction of the last (cosine above STRAIGHT_COSINE) is lengthened.  It stops after PATIENCE steps
    without gain.

    Raises:
        PredictionDiverged: where predictions diverge at phi.
    """
    best = now = _linearise_state(problem, _evaluate_twice(problem, phi, start, scales))
    last, vain = np.zeros_like(phi), 0
    for _ in range(leaps):
        leap = _try_leap(problem, now)
        if leap is None:
            break
        step = leap.state.phi - now.state.phi
        straight = float(last @ step) > STRAIGHT_COSINE * float(np.linalg.norm(last) * np.linalg.norm(step))
        now = _stretch_leap(problem, now.state, leap) if straight else leap
        last, vain = step, 0 if now.state.objective > best.state.objective + MIN_GAIN else vain + 1
        best = max(best, now, key=lambda point: point.state.objective)
        if vain == PATIENCE:
            break
    return best.tangent, best.state


def _try_leap(problem: RefitProblem, now: _LinearisedState) -> _LinearisedState | None:
    """The first damped Newton step of phi that does not lower the objective by SLACK nats or more; None if none.

    The objective is log-likelihood plus log prior, initial states and pushes being optimised again.  Dampings grow;
    if effects have places or times, all tries but the first hold these fixed.  A step that changes no component of
    phi by MIN_LEAP ends the search.  The state is linearised where the step ends.
    """
    phi, is_place, bounds = now.state.phi, problem.hypothesis.is_place, problem.hypothesis.bounds()
    steps = [(damping, bounds) for damping in LEAP_DAMPINGS]
    if is_place.any():  # over an edge on the floor no tangent holds: the next steps leave places where they are
        fixed = np.where(is_place, phi, bounds[0]), np.where(is_place, phi, bounds[1])
        steps[1:] = [(damping, fixed) for damping in LEAP_DAMPINGS]
    for damping, allowed in steps:
        ahead = newton.bounded_newton_step(phi, now.slope, now.curvature + damping * np.eye(len(phi)), allowed)
        if np.max(np.abs(ahead - phi)) < MIN_LEAP:
            break
        there = none_if_diverged(_linearise_if_better, problem, ahead, now.state, now.state.objective - SLACK)
        if there:
            return there
    return None


def _stretch_leap(problem: RefitProblem, before: RefitState, leap: _LinearisedState) -> _LinearisedState:
    """Lengthen the step of phi from `before` to `leap` 2, 4, 8 ... times while the objective gains (line search).

    A doubling is kept if log-likelihood plus log prior gains more than MIN_GAIN nats.  It ends at the first that does
    not, that diverges, or that the bounds of phi stop; the state is linearised there.
    """
    step, times, bounds = leap.state.phi - before.phi, 2.0, problem.hypothesis.bounds()
    while True:
        ahead = np.clip(before.phi + times * step, *bounds)
        if np.max(np.abs(ahead - leap.state.phi)) < MIN_LEAP:
            return leap
        least = leap.state.objective + MIN_GAIN
        further = none_if_diverged(_linearise_if_better, problem, ahead, leap.state, least)
        if further is None:
            return leap
        leap, times = further, 2.0 * times


def _linearise_if_better(
    problem: RefitProblem, phi: Floats, near: RefitState, min_objective: float
) -> _LinearisedState | None:
    """Evaluate a refit at the parameter vector phi, and linearise it; None if its objective is <= `min_objective`.

    The objective is log-likelihood plus log prior (nats).  Initial states, pushes and their scales are optimised from
    those of `near`.  Derivatives by phi, half the work, are computed last.
    """
    state = _evaluate_twice(problem, phi, near.start, near.scales)
    return _linearise_state(problem, state) if state.objective > min_objective else None


def _evaluate_twice(problem: RefitProblem, phi: Floats, start: Floats, scales: Scales) -> RefitState:
    """The refit's state at the parameter vector phi, with initial states, pushes, and noise and push scales optimised.

    They are optimised by `evaluate_at` from `start` (S, N_NUISANCE) and `scales`, then once more from the result,
    which is kept if log-likelihood plus log prior gains MIN_GAIN nats.
    """
    state = newton.evaluate_at(problem, phi, start, scales, MAX_EM_STEPS)
    again = none_if_diverged(newton.evaluate_at, problem, phi, state.start, state.scales, MAX_EM_STEPS)
    return again if again and again.objective > state.objective + MIN_GAIN else state


def _linearise_state(problem: RefitProblem, state: RefitState) -> _LinearisedState:
    """The refit's `state`, derivatives of its predicted poses, gradient and Gauss-Newton curvature of its objective.

    Gradient and curvature are by the parameter vector phi; the objective is log-likelihood plus log prior (nats).
    """
    tangent = newton.tangent_at(problem, state)
    return _LinearisedState(tangent, state, *newton.slope_and_curvature(problem, tangent, state))

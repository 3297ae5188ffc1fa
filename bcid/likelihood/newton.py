"""Newton steps on the marginal likelihood: a refit's state and tangent at some parameters, and where a step leads.

What predicts or estimates scales raises `PredictionDiverged` where these leave the finite numbers.
"""

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood import marginal, nuisance
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.jacobian import base_jacobian, parameter_jacobian
from bcid.likelihood.refit_state import EM_STEPS, RefitProblem, RefitState, Tangent, build_state
from bcid.likelihood.scales import Scales
from bcid.likelihood.settling import restart_misfitting_segments, settle_initial_states

MAX_STEP = 3.0  # of any component of phi


def evaluate_at(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, em_steps: int = EM_STEPS
) -> RefitState:
    """The refit's state (residual, likelihood, nuisances, scales) at the parameter vector phi, which stays fixed.

    Initial states move from `start` (S, N_NUISANCE) to where the likelihood is greatest; those of segments that then
    fit badly are found anew from their measured poses.  The standard deviations of noise and pushes are estimated from
    `scales` in at most `em_steps` of expectation maximisation.
    """
    at = nuisance.linearise_nuisances(problem.take, problem.hypothesis.prediction_inputs(phi, problem.take), start)
    state = build_state(problem, phi, start.copy(), scales, at.r, at.A, em_steps)
    return restart_misfitting_segments(problem, settle_initial_states(problem, state, em_steps), em_steps)


def tangent_at(problem: RefitProblem, state: RefitState) -> Tangent:
    """Linearisation of the predicted poses at a refit's `state`: their derivatives by nuisance and by base parameters.

    Those by nuisance parameters (each segment's initial state and pushes) are `state.A`.
    """
    return Tangent(state.A, base_jacobian(problem.take, problem.hypothesis, state.phi, state.start, state.r))


def derivatives_at(problem: RefitProblem, tangent: Tangent, state: RefitState) -> Floats:
    """Derivatives (N, 3, n) of the predicted poses by all of phi at a refit's `state`.

    Those by base parameters and a remainder's coefficients are those of the `tangent`; those by effects' parameters,
    which stand between them, are found by finite differences at the `state`.
    """
    return _add_effects(problem, tangent.J, state.phi, state.start, state.r)


def slope_and_curvature(problem: RefitProblem, state: RefitState, J: Floats) -> tuple[Floats, Floats]:
    """Gradient (n,) and Gauss-Newton curvature (n, n), about -Hessian, of log-likelihood plus log prior by phi.

    phi is the parameter vector (log base parameters, drag, effects' parameters), and J (N, 3, n) are the derivatives of
    the predicted poses by it.

    Raises:
        PredictionDiverged: either is not finite, as where a derivative is beyond what its square can be.
    """
    take, prior = problem.take, problem.prior
    r = nuisance.about_no_pushes(state.r, state.A, state.start, take.first)
    g, G = marginal.score_and_information(r, state.A, J, take.first, state.scales.r, state.terms.root)
    w = marginal.robust_weights(state.terms)
    slope, curvature = w @ g + prior.slope(state.phi), np.tensordot(w, G, axes=1) + np.diag(prior.stiffness(state.phi))
    require_finite("a slope of the likelihood", slope, curvature)
    return slope, curvature


def _add_effects(problem: RefitProblem, J: Floats, phi: Floats, start: Floats, r: Floats) -> Floats:
    """Derivatives (N, 3, n) by all of phi: `J`, as of `Tangent`, with those by effects' parameters between its parts.

    They are found by finite differences of predictions from `start`, where the residual is `r`.
    """
    hypothesis = problem.hypothesis
    own = range(hypothesis.base_size, hypothesis.named_size)
    effects = parameter_jacobian(problem.take, hypothesis, phi, start, r, own)
    base, functions = np.split(J, [hypothesis.base_size], axis=2)
    return np.concatenate([base, effects, functions], axis=2)


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

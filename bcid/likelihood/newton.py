"""Newton steps on the marginal likelihood: a refit's state and tangent at some parameters, and where a step leads.

What predicts or estimates scales raises `PredictionDiverged` where these leave the finite numbers.
"""

import math

import numpy as np

from bcid.aliases import Floats
from bcid.likelihood import marginal, nuisance
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.jacobian import base_jacobian, changed_cars, on_body_and_servo, parameter_jacobian
from bcid.likelihood.refit_state import EM_STEPS, RefitProblem, RefitState, Tangent, build_state
from bcid.likelihood.scales import Scales
from bcid.likelihood.settling import restart_misfitting_segments, settle_initial_states
from bcid.likelihood.take import N_START

MAX_STEP = 3.0  # of any component of phi
PROBE_STEP = 0.05  # in standard deviations of nuisances
PROBED_SEGMENTS = 40  # for which signs are drawn, or about: of fewer segments for each more than once
PROBE_SEED = 0  # of the signs by which the slope of log-determinants is found


def evaluate_at(
    problem: RefitProblem, phi: Floats, start: Floats, scales: Scales, em_steps: int = EM_STEPS,
    floor: float = -math.inf,
) -> RefitState:  # fmt: skip
    """The refit's state (residual, likelihood, nuisances, scales) at the parameter vector phi, which stays fixed.

    Initial states move from `start` (S, N_NUISANCE) to where the likelihood is greatest, those of segments with a high
    chi^2 from their measured poses.  The standard deviations of noise and pushes are estimated from `scales` in at most
    `em_steps` of expectation maximisation.  What is worth less than the `floor` (nats) need not be known exactly.
    """
    at = nuisance.linearise_nuisances(problem.take, problem.hypothesis.prediction_inputs(phi, problem.take), start)
    state = build_state(problem, phi, start.copy(), scales, at.r, at.A, em_steps)
    return settle_initial_states(problem, restart_misfitting_segments(problem, state, em_steps), em_steps, floor)


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
    the predicted poses by it.  The slope is that of chi^2 and, where the problem has one, of the `volume_slope`.

    Raises:
        PredictionDiverged: either is not finite, as where a derivative is beyond what its square can be.
    """
    take, prior = problem.take, problem.prior
    r = nuisance.about_no_pushes(state.r, state.A, state.start, take.first)
    g, G = marginal.score_and_information(r, state.A, J, take.first, state.scales.r, state.terms.root)
    w = marginal.robust_weights(state.terms)
    slope, curvature = w @ g + prior.slope(state.phi), np.tensordot(w, G, axes=1) + np.diag(prior.stiffness(state.phi))
    slope = slope if problem.volume is None else slope + problem.volume.slope
    require_finite("a slope of the likelihood", slope, curvature)
    return slope, curvature


def volume_slope(problem: RefitProblem, state: RefitState) -> Floats:
    """Gradient (n,) by phi of -1/2 log(|M| / |A_0^T W A_0|) over all segments: how poses answer pushes depends on phi.

    Of M = A^T R^-1 A + diag(0, Q^-1) = L L^T the logarithm changes by 2 tr(M^-1 A^T R^-1 dA), and so does that of
    A_0^T W A_0.  With signs xi drawn for each segment, z = L^-T xi and z_0 = L_00^-T xi_0, the mean of
    (A z - A_0 z_0)^T R^-1 (dA z) is half the difference (Hutchinson 1990), and dA z is the difference of the poses'
    derivatives by phi at nuisances that differ by z.  Fewer segments are drawn for more often.  Of effects it is left
    out, as it would cost ten times as much: it is below half a nat a standard error near a fit.  Without it a fit ends
    where chi^2 is least, which is not where it is likeliest: parameters that let poses answer pushes strongly need
    smaller ones.
    """
    rng, hypothesis = np.random.default_rng(PROBE_SEED), problem.hypothesis
    probes = max(1, round(PROBED_SEGMENTS / problem.take.segments))
    slope = np.zeros(hypothesis.size)
    for _ in range(probes):
        xi = rng.choice([-1.0, 1.0], size=state.start.shape)
        slope[: hypothesis.base_size] += _probe_volume(problem, state, xi) / probes
    require_finite("a slope of the likelihood", slope)
    return slope


def _probe_volume(problem: RefitProblem, state: RefitState, xi: Floats) -> Floats:
    """An estimate (base_size,) of the slope of log-determinants by signs `xi` (S, N_NUISANCE), right in the mean."""
    z = np.einsum("skp,sk->sp", state.terms.root, xi)
    z_beyond = z.copy()  # beyond what initial states alone make: of the root L^-1 the upper left block is L_00^-1
    z_beyond[:, :N_START] -= np.einsum("skp,sk->sp", state.terms.root[:, :N_START, :N_START], xi[:, :N_START])
    rows = np.diff(problem.take.first)
    weight = np.einsum("ncp,np->nc", state.A, np.repeat(z_beyond, rows, axis=0)) / state.scales.r**2
    ahead, behind = (_base_jacobian(problem, state, state.start + side * z) for side in (PROBE_STEP, -PROBE_STEP))
    return np.asarray(-np.einsum("nc,ncj->j", weight, ahead - behind) / (2.0 * PROBE_STEP))


def _base_jacobian(problem: RefitProblem, state: RefitState, start: Floats) -> Floats:
    """Derivatives (N, 3, base_size) of predicted poses from `start` by base parameters."""
    take, hypothesis = problem.take, problem.hypothesis
    inputs = hypothesis.prediction_inputs(state.phi, take)
    on_body = nuisance.parameter_answers(take, inputs, start, changed_cars(hypothesis, state.phi))
    r = nuisance.pose_residuals(take, inputs, start) if hypothesis.unknown_steering else state.r
    return on_body_and_servo(take, hypothesis, state.phi, start, r, on_body)


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

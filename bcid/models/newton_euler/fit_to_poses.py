"""Fitting the Newton-Euler model's constants to recorded poses: output error, with nothing smoothed in between.

A one-step fit takes the smoother's velocities for the truth; their errors are correlated from row to row, so that it is
biased by more than its standard errors say.  Here poses are predicted over stretches of 1.5 s from free initial
states, with forces of unknown size on the body, and the likelihood weighs both (`bcid.likelihood`).
"""

from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.aliases import Floats
from bcid.errors import PredictionDiverged
from bcid.likelihood.divergence import refuse_divergence
from bcid.likelihood.hypothesis import DRAG
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import segment_moments, student_log_densities
from bcid.likelihood.prepare import base_hypothesis, prepare_and_fit_base
from bcid.likelihood.refit import Fit
from bcid.likelihood.scale_estimate import estimate_scales
from bcid.likelihood.take import Take
from bcid.models.interface import FitTask
from bcid.models.limits import LIMITS
from bcid.models.newton_euler.initial_guess import guess_car
from bcid.models.newton_euler.parameters import (
    SATURATIONS,
    TOP_SPEED_QUANTILE,
    constant_facts,
    constants_to_fit,
    drag_per_speed,
)
from bcid.models.settings import NewtonEulerSettings
from bcid.physics.car import Car

MIN_DRAG = 1e-12  # SI units, in relative errors
STEERING_CONSTANTS = {
    "T_s": {"unit": "s", "meaning": "steering time constant"},
    "d": {"unit": "rad/s", "meaning": "steering rate limit"},
}


def fit_car_to_poses(task: FitTask) -> tuple[Car, dict[str, Any]]:
    """Fit the car's constants to recorded poses by maximum marginal likelihood; return car and facts of the fit.

    Poses are predicted over segments of 1.5 s from free initial states.  A throttle's dead zone u_0 is not fitted,
    but kept from the initial guess.  Facts hold the noise, standard errors, correlated pairs and constants at a
    bound.

    Raises:
        InputRefused: too little of the recordings can be used, or the model cannot follow them.
    """
    settings = NewtonEulerSettings.model_validate(task.settings)
    estimates = list(task.estimates)
    task.progress(0.02, "initial guess")
    start = guess_car(estimates, task.vehicle, *estimates[0].steering_constants(), settings.v_0_mps)
    hypothesis = base_hypothesis(task.vehicle, start, estimates)
    with threadpool_limits(1, "blas"):
        task.progress(0.1, "likelihood of the poses")
        with refuse_divergence(task.recordings):
            take, _, (fit, _) = prepare_and_fit_base(task.recordings, estimates, hypothesis, ())
        unreached = _find_unreached_saturations(fit, take)
    top_speed = float(np.quantile(np.concatenate([e.kinematic[:, 0] for e in estimates]), TOP_SPEED_QUANTILE))
    searched = constants_to_fit(task.vehicle, top_speed)
    known = {p.symbol: {"unit": p.unit, "meaning": p.meaning} for p in searched} | STEERING_CONSTANTS
    symbols, covariance = relative_error_covariance(fit, top_speed)
    unstated = [symbols.index(s) for s in unreached]
    covariance[unstated], covariance[:, unstated] = np.nan, np.nan
    ends = fit.hypothesis.is_at_bound(fit.phi)
    at_bound = [s for s, at_end in zip(fit.hypothesis.log_parameters, ends, strict=False) if at_end]
    x, y, yaw = 1e3 * fit.scales.r
    facts = {
        "optimiser": f"likelihood of the poses in {take.segments} stretches of 1.5 s",
        "loss": "poses",
        "fit_quality": f"noise of {x:.2g} and {y:.2g} mm, {yaw:.2g} mrad; ± as far as the model lacks nothing",
        "log_likelihood": fit.log_likelihood,
        **constant_facts({s: known[s] for s in symbols}, covariance, np.sqrt(np.diag(covariance)), at_bound),
        "top_speed_mps": top_speed,
        "mass_given": task.vehicle.body.mass_kg is not None,
    }
    return fit.car(), facts


def relative_error_covariance(fit: Fit, top_speed: float) -> tuple[list[str], Floats]:
    """Symbols of the n constants that a fit to poses reports, and the covariance (n, n) of their relative errors.

    Drag is reported as R_1 and as R_v = R_1 + R_2 v at `top_speed` (m/s).  Rows and columns are NaN where the standard
    error is more than LIMITS.max_prior_sd_share of the prior's.
    """
    car, logs = fit.car(), list(fit.hypothesis.log_parameters)
    n, (unit_1, unit_2) = len(logs), fit.hypothesis.drag_units
    R_v = drag_per_speed(car, top_speed)
    # D (relative error of a constant) / D phi.
    J = np.zeros((n + 2, n + len(DRAG)))
    J[:n, :n] = np.eye(n)
    J[n, n] = unit_1 / max(abs(car.R_1), MIN_DRAG)
    J[n + 1, n:] = np.array([unit_1, unit_2 * top_speed]) / max(abs(R_v), MIN_DRAG)
    base = fit.covariance[: n + len(DRAG), : n + len(DRAG)]
    covariance: Floats = J @ base @ J.T
    unknown = np.sqrt(np.diag(base)) > LIMITS.max_prior_sd_share * LIKELIHOOD_LIMITS.base_prior_sd
    unknown = np.r_[unknown[:n], unknown[n], unknown[n:].any()]
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan
    return [*logs, "R_1", "R_v"], covariance


def _find_unreached_saturations(fit: Fit, take: Take) -> list[str]:
    """Symbols of the saturation forces (motor, front and rear tyres) that the car does not reach in the recordings.

    Likelihood-ratio test: with the limit at infinity, other constants fixed, the log-likelihood falls by less than
    LIMITS.min_saturation_nats.
    """
    hypothesis, found = fit.hypothesis, list[str]()
    for j, symbol in enumerate(hypothesis.log_parameters):
        if symbol not in SATURATIONS:
            continue
        phi = fit.phi.copy()
        phi[j] = np.inf
        try:
            r = fit.residuals(take, phi)
            free = student_log_densities(
                estimate_scales(segment_moments(r, fit.tangent.A, take.first), fit.scales, 0)[1]
            ).sum()
        except PredictionDiverged:  # without the force the car diverges, so it is reached
            continue
        if fit.log_likelihood - free < LIMITS.min_saturation_nats:
            found.append(symbol)
    return found

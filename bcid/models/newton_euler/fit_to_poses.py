"""Fitting the Newton-Euler model's constants to recorded poses: output error, with nothing smoothed in between.

A one-step fit takes the smoother's velocities for the truth; their errors are alike from row to row, so that it is
biased by more than it says.  Here poses are predicted over stretches of 1.5 s from free initial states, with forces of
unknown size on the body, and the likelihood weighs both (`bcid.likelihood`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.likelihood.hypothesis import DRAG, PRIOR_SD
from bcid.likelihood.marginal import log_likelihood, moments, rescaled
from bcid.likelihood.nuisance import deviations
from bcid.likelihood.prepare import base_from, base_of, suited
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take
from bcid.models.interface import FitTask
from bcid.models.newton_euler.initial_guess import started_car
from bcid.models.newton_euler.parameters import LIMITS, correlated, parameters
from bcid.models.settings import NewtonEulerSettings
from bcid.physics.car import Car

OF_THE_PRIOR = 0.5  # of its standard deviation: who knows no more has learnt little from the poses
TINY = 1e-12
SHOWN = 6.0  # nats that a limit must gain, all other constants held, which takes part of it for nothing
STEERING = {"T_s": ("s", "steering time constant"), "d": ("rad/s", "steering rate limit")}


def fit_car_to_poses(task: FitTask) -> tuple[Car, dict[str, Any]]:
    """The likeliest car, and how it was found; a throttle's dead zone is held as one-step predictions give it.

    Raises:
        InputRefused: when too little of the recordings can be used, or the model cannot follow them.
    """
    settings = NewtonEulerSettings.model_validate(task.settings)
    known, estimates = task.estimates[0].facts, list(task.estimates)
    task.progress(0.02, "a first car")
    start = started_car(estimates, task.vehicle, known["T_s"], known["d"], settings.v_0_mps)
    hypothesis = base_of(task.vehicle, start, estimates)
    with threadpool_limits(1, "blas"):
        try:
            task.progress(0.1, "likelihood of the poses")
            take, _, fit = base_from(task.recordings, estimates, hypothesis, ())
            take, fit = suited(take, fit)
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            raise InputRefused(
                task.recordings[0].sources[0].path, "poses and commands", f"the model cannot follow them: {error}",
                "check the vehicle file's mass, distances and limits, and the recording's units",
            ) from error  # fmt: skip
        unreached = _unreached(fit, take)
    top = float(np.quantile(np.concatenate([e.kinematic[:, 0] for e in estimates]), 0.999))
    return fit.car(), _facts(fit, take.segments, unreached, task, top)


def _facts(fit: Fit, stretches: int, unreached: list[str], task: FitTask, top: float) -> dict[str, Any]:
    about = {p.symbol: (p.unit, p.meaning) for p in parameters(task.vehicle, top)} | STEERING
    symbols, covariance = stated(fit, top)
    hidden = [symbols.index(s) for s in unreached]
    covariance[hidden], covariance[:, hidden] = np.nan, np.nan
    errors = np.sqrt(np.diag(covariance))
    hypothesis = fit.hypothesis
    x, y, yaw = 1e3 * fit.scales.r
    return {
        "optimiser": f"likelihood of the poses in {stretches} stretches of 1.5 s",
        "loss": "poses",
        "reached": f"noise of {x:.2g} and {y:.2g} mm, {yaw:.2g} mrad; ± as far as the model lacks nothing",
        "log_likelihood": fit.log_likelihood,
        "fitted": {
            symbol: {
                "unit": about[symbol][0], "meaning": about[symbol][1],
                "relative_se": float(se) if np.isfinite(se) else None,
            }
            for symbol, se in zip(symbols, errors, strict=True)
        },
        "correlated": correlated(covariance, symbols),
        "at_bound": [s for s, at_end in zip(hypothesis.logs, hypothesis.at_bound(fit.phi), strict=False) if at_end],
        "top_speed_mps": top,
        "mass_given": task.vehicle.body.mass_kg is not None,
    }  # fmt: skip


def stated(fit: Fit, top_speed: float) -> tuple[list[str], Floats]:
    """The constants that a fit states, and the covariance of their relative errors.

    Of the drag, R_1 and the drag per speed R_v at the top speed.  NaN where the poses say less than the prior does.
    """
    car, logs = fit.car(), list(fit.hypothesis.logs)
    n, (of_1, of_2) = len(logs), fit.hypothesis.drag_units
    R_v = car.R_1 + car.R_2 * top_speed
    to = np.zeros((n + 2, n + len(DRAG)))  # relative errors of what is stated, per unit of phi
    to[:n, :n] = np.eye(n)
    to[n, n], to[n + 1, n:] = of_1 / max(abs(car.R_1), TINY), np.array([of_1, of_2 * top_speed]) / max(abs(R_v), TINY)
    base = fit.covariance[: n + len(DRAG), : n + len(DRAG)]
    covariance: Floats = to @ base @ to.T
    unshown = np.sqrt(np.diag(base)) > OF_THE_PRIOR * PRIOR_SD
    unshown = np.r_[unshown[:n], unshown[n], unshown[n:].any()]
    covariance[unshown], covariance[:, unshown] = np.nan, np.nan
    return [*logs, "R_1", "R_v"], covariance


def _unreached(fit: Fit, take: Take) -> list[str]:
    """Limits without which the poses are as likely: they do not show them, whatever the slope at a few samples says."""
    hypothesis, found = fit.hypothesis, list[str]()
    for j, symbol in enumerate(hypothesis.logs):
        if symbol not in LIMITS:
            continue
        phi = fit.phi.copy()
        phi[j] = np.inf
        try:
            r = deviations(take, hypothesis.setting(phi, take), fit.start, fit.tangent.A)
            free = log_likelihood(rescaled(moments(r, fit.tangent.A, take.first), fit.scales, 0)[1]).sum()
        except FloatingPointError:  # without it the car leaves the finite numbers
            continue
        if fit.log_likelihood - free < SHOWN:
            found.append(symbol)
    return found

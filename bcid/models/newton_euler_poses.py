"""Fitting the Newton-Euler model's constants to recorded poses: output error, with nothing smoothed in between.

A one-step fit takes the smoother's velocities for the truth; their errors are alike from row to row, so that it is
biased by more than it says.  Here poses are predicted over stretches of 1.5 s from free initial states, with forces of
unknown size on the body, and the likelihood weighs both (`bcid.likelihood`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.errors import InputRefused
from bcid.likelihood.hypothesis import DRAG, DRAG_UNIT
from bcid.likelihood.recordings import base_from, base_of
from bcid.likelihood.refit import Fit
from bcid.models.interface import FitTask
from bcid.models.newton_euler_parameters import parameters
from bcid.models.newton_euler_start import started_car
from bcid.models.settings import NewtonEulerSettings
from bcid.physics.car import Car

NEAR_BOUND = 1e-3  # of phi


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
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            raise InputRefused(
                task.recordings[0].sources[0].path, "poses and commands", f"the model cannot follow them: {error}",
                "check the vehicle file's mass, distances and limits, and the recording's units",
            ) from error  # fmt: skip
    top = float(np.quantile(np.concatenate([e.kinematic[:, 0] for e in estimates]), 0.999))
    return fit.car(), _facts(fit, take.segments, task, top)


def _facts(fit: Fit, stretches: int, task: FitTask, top: float) -> dict[str, Any]:
    errors, about = relative_errors(fit, top), {p.symbol: p for p in parameters(task.vehicle, top)}
    hypothesis, (low, high) = fit.hypothesis, fit.hypothesis.bounds()
    ends = np.minimum(fit.phi - low, high - fit.phi) < NEAR_BOUND
    x, y, yaw = 1e3 * fit.scales.r
    return {
        "optimiser": f"likelihood of the poses in {stretches} stretches of 1.5 s",
        "loss": "poses",
        "reached": f"noise of {x:.2g} and {y:.2g} mm, {yaw:.2g} mrad",
        "log_likelihood": fit.log_likelihood,
        "fitted": {
            symbol: {"unit": about[symbol].unit, "meaning": about[symbol].meaning, "relative_se": se}
            for symbol, se in errors.items()
            if symbol in about
        },
        "correlated": [],
        "at_bound": [s for s, at_end in zip(hypothesis.logs, ends, strict=False) if at_end],
        "top_speed_mps": top,
        "mass_given": task.vehicle.body.mass_kg is not None,
    }


def relative_errors(fit: Fit, top_speed: float) -> dict[str, float]:
    """Standard errors of a fit's constants, and of the drag per speed R_v at the top speed, as shares of them."""
    car, logs = fit.car(), fit.hypothesis.logs
    n = len(logs)
    unit = DRAG_UNIT * car.m
    drag = unit**2 * fit.covariance[n : n + len(DRAG), n : n + len(DRAG)]
    along = np.array([1.0, top_speed])
    values = {"R_1": car.R_1, "R_2": car.R_2, "R_v": float(along @ [car.R_1, car.R_2])}
    variances = {"R_1": drag[0, 0], "R_2": drag[1, 1], "R_v": along @ drag @ along}
    spread = dict(zip(logs, np.sqrt(np.diag(fit.covariance)[:n]).tolist(), strict=True))
    return spread | {s: float(np.sqrt(v) / max(abs(values[s]), 1e-12)) for s, v in variances.items()}

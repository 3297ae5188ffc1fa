"""The estimate of one recording: filter, smoother, grid."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from bcid.errors import InputRefused
from bcid.estimate import kernel
from bcid.estimate.consistency import Truth, nis_facts, truth_facts
from bcid.estimate.events import timeline
from bcid.estimate.noise import as_facts
from bcid.estimate.outputs import kinematic_sd, kinematic_states, twist_covariances, twists
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

Engine = Literal["compiled", "filterpy"]


def estimate_motion(
    recording: Recording,
    vehicle: Vehicle,
    tuning: Tuning,
    period_s: float = 0.1,
    max_gap_s: float = 0.3,
    engine: Engine = "compiled",
    truth: Truth | None = None,
) -> Estimate:
    """Smoothed motion of `recording` on a grid of `period_s`.

    `engine` "filterpy" runs the reference instead of the compiled kernel; the two agree to 1e-9.

    Raises:
        InputRefused: when no grid row is covered by poses and commands.
    """
    line = timeline(recording, vehicle, period_s, max_gap_s)
    if len(line.grid) < 2:
        raise InputRefused(
            recording.sources[0].path,
            "time",
            "poses and commands together cover no two grid rows",
            "record a longer take",
        )
    chassis = tuning.chassis(vehicle)
    run_filter, run_smoother = kernel.run_filter, kernel.run_smoother
    if engine == "filterpy":
        from bcid.estimate import reference

        run_filter, run_smoother = reference.run_filter, reference.run_smoother
    filtered = run_filter(line.events, chassis, tuning.noise.Q(), tuning.noise.R())
    x, P = run_smoother(filtered, line.events.restart)
    x, P = np.ascontiguousarray(x[line.grid]), np.ascontiguousarray(P[line.grid])
    covariance = twist_covariances(x, P, chassis)
    facts: dict[str, Any] = {
        "noise": as_facts(tuning.noise),
        "T_s": tuning.T_s,
        "d": tuning.d,
        "nis": nis_facts(filtered.nis, filtered.dof),
        "log_likelihood": float(filtered.log_likelihood),
    }
    estimate = Estimate(
        name=recording.name,
        period_s=period_s,
        time_s=line.events.time_s[line.grid],
        segment=line.segment,
        pose=x[:, :3],
        twist=twists(x, chassis),
        kinematic=kinematic_states(x),
        command=line.command,
        twist_sd=np.sqrt(np.einsum("kii->ki", covariance)),
        kinematic_sd=kinematic_sd(P),
        facts=facts,
    )
    if truth is not None:
        rows = np.rint(estimate.time_s / period_s).astype(int)  # truth stands at multiples of the period
        facts["truth"] = truth_facts(estimate, covariance, Truth(truth.twist[rows], truth.kinematic[rows]))
    return estimate

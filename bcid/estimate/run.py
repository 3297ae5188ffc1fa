"""The estimate of one recording: filter, smoother, grid; and its check against a simulation's truth."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np

from bcid.errors import InputRefused
from bcid.estimate import kernel
from bcid.estimate.consistency import Truth, nees_facts, nis_facts, rmse_facts
from bcid.estimate.events import Timeline, timeline
from bcid.estimate.kernel import Filtered
from bcid.estimate.noise import as_facts
from bcid.estimate.outputs import kinematic_sd, kinematic_states, twist_covariances, twists
from bcid.estimate.process import Chassis
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate, Floats
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

Engine = Literal["compiled", "filterpy"]


class _Pass(NamedTuple):
    line: Timeline
    chassis: Chassis
    filtered: Filtered
    x: Floats  # (K, 7) smoothed, at the grid rows
    P: Floats  # (K, 7, 7)


def _run(
    recording: Recording, vehicle: Vehicle, tuning: Tuning, period_s: float, max_gap_s: float, engine: Engine
) -> _Pass:
    line = timeline(recording, vehicle, period_s, max_gap_s, tuning.T_s, tuning.d)
    if len(line.grid) < 2:
        raise InputRefused(
            recording.sources[0].path,
            "time",
            "poses and commands together cover no two grid rows",
            "record a longer take, or check the time stamps",
        )
    chassis = tuning.chassis(vehicle)
    run_filter, run_smoother = kernel.run_filter, kernel.run_smoother
    if engine == "filterpy":
        from bcid.estimate import reference

        run_filter, run_smoother = reference.run_filter, reference.run_smoother
    filtered = run_filter(line.events, chassis, tuning.noise.Q(), tuning.noise.R())
    x, P = run_smoother(filtered, line.events.restart)
    return _Pass(line, chassis, filtered, np.ascontiguousarray(x[line.grid]), np.ascontiguousarray(P[line.grid]))


def estimate_motion(
    recording: Recording,
    vehicle: Vehicle,
    tuning: Tuning,
    period_s: float = 0.1,
    max_gap_s: float = 0.3,
    engine: Engine = "compiled",
) -> Estimate:
    """Smoothed motion of `recording` on a grid of `period_s`.

    `engine` "filterpy" runs the reference instead of the compiled kernel; the two agree to 1e-9.

    Raises:
        InputRefused: when no grid row is covered by poses and commands.
    """
    line, chassis, filtered, x, P = _run(recording, vehicle, tuning, period_s, max_gap_s, engine)
    variances = np.einsum("kii->ki", twist_covariances(x, P, chassis))
    facts: dict[str, Any] = {
        "noise": as_facts(tuning.noise),
        "T_s": tuning.T_s,
        "d": tuning.d,
        "tuning": dict(tuning.facts),
        "nis": nis_facts(filtered.nis, filtered.dof),
        "log_likelihood": float(filtered.log_likelihood),
    }
    return Estimate(
        name=recording.name,
        period_s=period_s,
        time_s=line.events.time_s[line.grid],
        segment=line.segment,
        pose=x[:, :3],
        twist=twists(x, chassis),
        kinematic=kinematic_states(x),
        command=line.command,
        twist_sd=np.sqrt(np.maximum(variances, 0.0)),
        kinematic_sd=kinematic_sd(P),
        facts=facts,
    )


def check_against_truth(
    recording: Recording, vehicle: Vehicle, tuning: Tuning, period_s: float, max_gap_s: float, truth: Truth
) -> dict[str, Any]:
    """RMSE of the smoothed motion, and NEES of filter and smoother, on a simulated take.

    The smoother's NEES lies below 3 where the process noise has to cover transients: its standard
    deviations are then cautious while the car drives steadily.

    Raises:
        InputRefused: when no row of the truth meets the grid.
    """
    line, chassis, filtered, x, P = _run(recording, vehicle, tuning, period_s, max_gap_s, "compiled")
    known, rows = truth.at(line.events.time_s[line.grid])
    if not rows.any():
        raise InputRefused(
            recording.sources[0].path, "truth", "no row of the truth stands at a grid time", "use a period_s of 0.1 s"
        )
    x_f = np.ascontiguousarray(filtered.x[line.grid])
    P_f = np.ascontiguousarray(filtered.P[line.grid])
    return {
        "name": recording.name,
        "rmse": rmse_facts(twists(x, chassis)[rows], kinematic_states(x)[rows], known),
        "nees_smoother": nees_facts(twists(x, chassis)[rows], twist_covariances(x, P, chassis)[rows], known),
        "nees_filter": nees_facts(twists(x_f, chassis)[rows], twist_covariances(x_f, P_f, chassis)[rows], known),
    }

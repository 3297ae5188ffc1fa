"""The estimate of one recording: filter, smoother, grid; and its check against a simulation's truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.estimate import kernel
from bcid.estimate.consistency import Truth, nees_facts, nis_facts, rmse_facts
from bcid.estimate.events import Timeline, timeline
from bcid.estimate.kernel import Filtered
from bcid.estimate.noise import as_facts
from bcid.estimate.outputs import kinematic_sd, kinematic_states, twist_covariances, twists
from bcid.estimate.process import Chassis
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

Engine = Literal["compiled", "filterpy"]
MOST_RESTARTS = 20  # of a filter that loses the car, beyond which it does not follow at all


class _Pass(NamedTuple):
    line: Timeline
    chassis: Chassis
    filtered: Filtered
    x: Floats  # (K, 7) smoothed, at the grid rows
    P: Floats  # (K, 7, 7)
    restarts_s: tuple[float, ...]  # when it had lost the car and began anew


def _run(
    recording: Recording, vehicle: Vehicle, tuning: Tuning, period_s: float, max_gap_s: float, engine: Engine
) -> _Pass:
    """The filter and the smoother; where the filter loses the car so far that its covariance is none, it begins anew.

    Raises:
        InputRefused: poses and commands that cover no grid, or that the filter cannot follow.
    """
    chassis, restarts = tuning.chassis(vehicle), list[float]()
    run_filter, run_smoother = kernel.run_filter, kernel.run_smoother
    if engine == "filterpy":
        from bcid.estimate import reference

        run_filter, run_smoother = reference.run_filter, reference.run_smoother
    while True:
        anew = replace(recording, breaks_s=tuple(sorted({*recording.breaks_s, *restarts})))
        line = timeline(anew, vehicle, period_s, max_gap_s, tuning.T_s, tuning.d)
        if len(line.grid) < 2:
            cause = "poses and commands together cover no two grid rows"
            step = "record a longer take, or check the time stamps"
            raise InputRefused(recording.sources[0].path, "time", cause, step)
        filtered = run_filter(line.events, chassis, tuning.noise.Q(), tuning.noise.R())
        lost = np.flatnonzero(~(filtered.nis >= 0.0))  # an innovation's variance is positive, or the filter is lost
        if not len(lost):
            break
        restarts.append(float(line.events.time_s[lost[0]]))
        if len(restarts) > MOST_RESTARTS:
            cause = f"the velocity estimate loses the car {len(restarts)} times, first there"
            step = "check units and axes of the poses, or leave [estimate.noise] out so that the noise is found"
            raise InputRefused(recording.sources[0].path, f"{restarts[0]:.3f} s", cause, step)
    x, P = run_smoother(filtered, line.events.restart)
    x, P = np.ascontiguousarray(x[line.grid]), np.ascontiguousarray(P[line.grid])
    return _Pass(line, chassis, filtered, x, P, tuple(restarts))


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
        InputRefused: when no grid row is covered by poses and commands, or the filter cannot follow them.
    """
    line, chassis, filtered, x, P, restarts_s = _run(recording, vehicle, tuning, period_s, max_gap_s, engine)
    variances = np.einsum("kii->ki", twist_covariances(x, P, chassis))
    facts: dict[str, Any] = {
        "noise": as_facts(tuning.noise),
        "T_s": tuning.T_s,
        "d": tuning.d,
        "tuning": dict(tuning.facts),
        "nis": nis_facts(filtered.nis, filtered.dof),
        "log_likelihood": float(filtered.log_likelihood),
        "restarts_s": list(restarts_s),
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
    line, chassis, filtered, x, P, _ = _run(recording, vehicle, tuning, period_s, max_gap_s, "compiled")
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

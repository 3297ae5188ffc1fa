"""The estimate of one recording: filter, smoother, grid; and its check against the truth of a simulation."""

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.estimate import blockwise
from bcid.estimate.blockwise import ForwardPass
from bcid.estimate.consistency import Truth, TruthCheck, rmse_by_state, summarise_nees, summarise_nis
from bcid.estimate.events import Timeline, build_chassis, build_timeline
from bcid.estimate.limits import LIMITS
from bcid.estimate.process import Chassis, kinematic_sd, kinematic_states, twist_covariances, twists
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate, FilterSummary
from bcid.libraries import require_library
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

Engine = Literal["compiled", "filterpy"]


class _SmoothedPass(NamedTuple):
    """A recording after filter and smoother, with the rows of its output grid."""

    timeline: Timeline
    chassis: Chassis
    filtered: ForwardPass
    x: Floats  # (K, 7) smoothed, at the grid rows
    P: Floats  # (K, 7, 7)
    restarts_s: tuple[float, ...]  # when the filter had lost the car and was restarted


def _filter_and_smooth(
    recording: Recording, vehicle: Vehicle, tuning: Tuning, period_s: float, max_gap_s: float, engine: Engine
) -> _SmoothedPass:
    """Run EKF and smoother over a recording, restarting the filter where it diverges (a negative or undefined NIS).

    The result is kept at the rows of a grid of `period_s`, without pose gaps longer than `max_gap_s`; `engine` is the
    compiled kernel or "filterpy", the slow reference.

    Raises:
        InputRefused: poses and commands cover no two grid rows, or restarts exceed `LIMITS.max_restarts`.
        LibraryMissing: the `engine` "filterpy" is asked for and not installed.
    """
    chassis, restarts = build_chassis(vehicle, tuning.T_s, tuning.d), list[float]()
    Q, R = tuning.noise.Q(), tuning.noise.R()
    run_forward, run_backward = blockwise.run_forward, blockwise.run_backward
    if engine == "filterpy":
        require_library("filterpy", 'engine = "filterpy" of [estimate]')
        from bcid.estimate import reference

        run_forward, run_backward = reference.run_forward, reference.run_backward
    while True:
        restarted = replace(recording, breaks_s=tuple(sorted({*recording.breaks_s, *restarts})))
        timeline = build_timeline(restarted, vehicle, period_s, max_gap_s, tuning.T_s, tuning.d)
        if len(timeline.grid) < 2:
            cause = "poses and commands together cover no two grid rows"
            step = "record a longer take, or check the time stamps"
            raise InputRefused(recording.sources[0].path, "time", cause, step)
        filtered = run_forward(timeline.events, timeline.grid, chassis, Q, R)
        # an innovation's variance is positive, or the filter is lost
        lost = np.flatnonzero(~(filtered.nis >= 0.0))
        if not len(lost):
            break
        restarts.append(float(timeline.events.time_s[lost[0]]))
        if len(restarts) > LIMITS.max_restarts:
            cause = f"the velocity estimate loses the car {len(restarts)} times, first there"
            step = "check units and axes of the poses, or leave [estimate.noise] out so that the noise is identified"
            raise InputRefused(recording.sources[0].path, f"{restarts[0]:.3f} s", cause, step)
    x, P = run_backward(filtered, timeline.grid)
    return _SmoothedPass(timeline, chassis, filtered, x, P, tuple(restarts))


def estimate_motion(
    recording: Recording,
    vehicle: Vehicle,
    tuning: Tuning,
    period_s: float = 0.1,
    max_gap_s: float = 0.3,
    engine: Engine = "compiled",
) -> Estimate:
    """The motion of a recording (pose, twist, slip angles, steering) by EKF and smoother, on a grid of `period_s`.

    `tuning` holds the noise and the steering's constants; pose gaps longer than `max_gap_s` end a segment.  The
    `engine` "filterpy" replaces the compiled kernel by a slow reference; the two agree to 1e-9.

    Raises:
        InputRefused: poses and commands cover no two grid rows, or the filter diverges again and again.
    """
    smoothed = _filter_and_smooth(recording, vehicle, tuning, period_s, max_gap_s, engine)
    timeline, chassis, filtered, x, P, restarts_s = smoothed
    variances = np.einsum("kii->ki", twist_covariances(x, P, chassis))
    return Estimate(
        name=recording.name,
        period_s=period_s,
        time_s=timeline.events.time_s[timeline.grid],
        segment=timeline.segment,
        pose=x[:, :3],
        twist=twists(x, chassis),
        kinematic=kinematic_states(x),
        parts=timeline.parts,
        twist_sd=np.sqrt(np.maximum(variances, 0.0)),
        kinematic_sd=kinematic_sd(P),
        tuning=tuning,
        filter=FilterSummary(
            nis=summarise_nis(filtered.nis, filtered.dof),
            log_likelihood=float(filtered.log_likelihood),
            restarts_s=restarts_s,
        ),
    )


def check_against_truth(
    recording: Recording, vehicle: Vehicle, tuning: Tuning, period_s: float, max_gap_s: float, truth: Truth
) -> TruthCheck:
    """RMSE of the motion estimated from a simulated recording against the true one, and NEES of EKF and smoother.

    NEES is the normalised squared error e^T P^-1 e of the twist, 3 on average where its covariance P is right.  That
    of the smoother lies below 3 where the process noise, identified to cover transients, is too large for steady
    driving.

    Raises:
        InputRefused: no row of the truth is at a time of the grid of `period_s`.
    """
    smoothed = _filter_and_smooth(recording, vehicle, tuning, period_s, max_gap_s, "compiled")
    timeline, chassis, filtered, x, P, _ = smoothed
    known, rows = truth.align_to(timeline.events.time_s[timeline.grid])
    if not rows.any():
        cause = "no row of the truth stands at a grid time"
        raise InputRefused(recording.sources[0].path, "truth", cause, "use a period_s of 0.1 s")
    x_f, P_f = filtered.x, filtered.P
    twist, kinematic = twists(x, chassis)[rows], kinematic_states(x)[rows]
    return TruthCheck(
        name=recording.name,
        rmse=rmse_by_state(twist, kinematic, known),
        nees_smoother=summarise_nees(twist, twist_covariances(x, P, chassis)[rows], known),
        nees_filter=summarise_nees(twists(x_f, chassis)[rows], twist_covariances(x_f, P_f, chassis)[rows], known),
    )

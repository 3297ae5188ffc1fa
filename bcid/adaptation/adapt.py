"""A car adapted over a recording: poses come in one by one, as they would on line.

At each row of the estimate the pose is taken between the last one that was measured and the next, which on line comes
up to `MAX_POSES_APART` poses, or one row, later.  What the filter assumes is tuned to the recording beforehand
(`tune_noise`), and each stretch begins with the smoothed twist.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bcid.adaptation.filter import (
    CompiledFilter,
    FilterNoise,
    Knowledge,
    assume_noise,
    compile_filter,
    forget,
    share_forgotten,
    start_filter,
)
from bcid.adaptation.filter_run import run_filter
from bcid.adaptation.formulas import AdaptiveFormulas, trace_adaptive
from bcid.adaptation.quantities import AdaptedQuantity, choose_quantities, with_quantities
from bcid.adaptation.settings import FORGET_S
from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused, UsageError
from bcid.estimate.types import Estimate
from bcid.likelihood.prepare import effect_constants
from bcid.models.interface import Model
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

STEERING_SD_RAD = 0.1
"""Standard deviation of the steering angle at the beginning of a stretch, where the wheel's past is not known."""
TWIST_SD_SHARE = 0.2
"""Standard deviation of the twist at the beginning of a stretch, as a share of its root mean square while tuning."""
PUSH_RANGE = (1e-3, 10.0)
"""Smallest and largest push that is tried, per root second, as a share of the twist's root mean square while tuning."""
TUNING_S = 60.0
"""Time (s) for which the car has moved when the pushes are tuned, under which all of the recording is followed."""
FIRST_PUSHES = (0.005, 0.05, 0.5)
"""Pushes, as that share, from the likeliest of which the best is sought: a wrong car is likely by large ones alone.
What lasts is sought from the same share of it in a second."""
DEFAULT_POSE_SD = (1e-3, 1e-3, 2e-3)
"""Standard deviations (m, m, rad) of poses where no filter has identified them: those of an optical tracking system."""
LEAST_BRAKE = 0.02
"""Share of a brake of its own from which it acts: below it a pedal idles."""
MAX_POSES_APART = 3.0
"""Periods of the tracking system over which a pose is taken from its neighbours."""


class MeasuredDrive(NamedTuple):
    """What the filter is given of a recording: its estimate, for commands and first twists, and measured poses."""

    estimate: Estimate
    poses: Floats  # (K, 3) at the rows of the estimate; NaN where none was measured

    def stretches(self) -> list[slice]:
        """The rows of each stretch without gaps, of more than one row."""
        return [s for s in self.estimate.segments() if s.stop - s.start > 1]

    def without_braking(self) -> MeasuredDrive:
        """The drive with gaps where a brake of its own acts, of which the filter is not told."""
        brake = (self.estimate.parts[..., 3] * (self.estimate.parts[..., 0] > 0.0)).max(axis=1, initial=0.0)
        return self._only_where(np.append(brake, 0.0)[: len(self.estimate)] < LEAST_BRAKE)

    def _only_where(self, wanted: Bools) -> MeasuredDrive:
        """The drive with gaps between stretches where rows (K,) are not `wanted`."""
        # each of the others is a segment by itself, too short for a stretch
        begins = (np.diff(self.estimate.segment) != 0) | ~wanted[1:] | ~wanted[:-1]
        return self._replace(estimate=replace(self.estimate, segment=np.r_[0, np.cumsum(begins)]))

    def first_motion(self, least_mps: float, seconds: float) -> MeasuredDrive:
        """The drive from where the car first moves until it has moved for some `seconds`, as far as it goes.

        The car moves where it is faster than `least_mps`.  The time in which it stands is a gap between stretches.
        """
        moves = np.abs(self.estimate.kinematic[:, 0]) > least_mps
        at = np.flatnonzero(moves)[: max(2, round(seconds / self.estimate.period_s))]
        rows = slice(at[0], at[-1] + 1) if len(at) else slice(0)
        return MeasuredDrive(self._only_where(moves).estimate.select_rows(rows), self.poses[rows])


class Track(NamedTuple):
    """What the filter makes of the K rows of a drive."""

    values: Floats  # (K, k) of the quantities
    sd: Floats  # (K, k)
    innovation: Floats  # (K, 3) of the poses: m, m, rad; NaN where none was measured
    log_likelihood: float  # of the poses, each from those before it
    covariance: Floats  # (k, k) of the quantities at the end


@dataclass(frozen=True)
class Adaptation:
    """The adapted quantities over a recording, at the rows of its estimate."""

    model: AugmentedNewtonEuler  # with the quantities at their first values
    quantities: tuple[AdaptedQuantity, ...]
    formulas: AdaptiveFormulas
    filter: CompiledFilter
    noise: FilterNoise
    drive: MeasuredDrive
    track: Track

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities that are followed."""
        return tuple(quantity.name for quantity in self.quantities)

    def model_at(self, row: int) -> AugmentedNewtonEuler:
        """The car as it is known at a row of the estimate."""
        values = self.track.values[row].tolist()
        return with_quantities(self.model, list(zip(self.quantities, values, strict=True)))


def as_adaptable(model: Model, vehicle: Vehicle, estimate: Estimate) -> AugmentedNewtonEuler:
    """The car of a saved model, with room for effects, on the grid of an estimate.

    Raises:
        UsageError: the model is of another kind, which has no constants of a car, or free functions beside them.
    """
    if isinstance(model, AugmentedNewtonEuler):
        return model.with_period(estimate.period_s)
    if isinstance(model, NewtonEuler):
        length_s = float(np.ptp(estimate.time_s))
        constants, limit = effect_constants(vehicle), vehicle.steering.max_angle_rad
        return AugmentedNewtonEuler(model.car, {}, constants, limit, length_s, estimate.period_s, {})
    if isinstance(model, NewtonEulerWithRemainder):
        raise UsageError(
            f"{model.name} has free functions, which would be right for one car alone\n"
            "  next: name the diagnosed car with names alone, the folder `model` beside it"
        )
    raise UsageError(
        f"{model.name} has no constants of a car that could be adapted\n"
        "  next: name a newton-euler model, or the one of a diagnosis"
    )


def adapt(
    model: AugmentedNewtonEuler, names: Sequence[str], recording: Recording, estimate: Estimate,
    noise: FilterNoise | None = None, forget_s: float = FORGET_S,
) -> Adaptation:  # fmt: skip
    """Adapt the quantities called `names` of a car to the poses of a recording, from its beginning to its end.

    The `estimate` gives the commands on the model's grid and the twist with which each stretch begins.  Without
    `noise`, the pushes are those under which the poses of the first minute of motion are likeliest.

    Raises:
        UsageError: a name is no quantity of this car, or `forget_s` is no time.
        InputRefused: the recording has no stretch that is long enough, or, without `noise`, none in which the car
            moves; a brake of its own acts in all of it; or the filter leaves the finite numbers.
    """
    if not 0.0 < forget_s < math.inf:
        raise UsageError(f"nothing is forgotten in {forget_s:g} s\n  next: give a time (s), such as {FORGET_S:g}")
    switched, quantities = choose_quantities(model, names)
    formulas = trace_adaptive(switched, quantities)
    drive = MeasuredDrive(estimate, poses_at_rows(recording, estimate)).without_braking()
    if not drive.stretches():
        cause = "have no stretch without gaps, and without a brake of its own"
        raise InputRefused(recording.name, "poses", cause, "record longer ones")
    compiled = compile_filter(formulas)
    if noise is None:
        motion = drive.first_motion(compiled.least_mps, TUNING_S)
        if not motion.stretches():
            cause = f"show no car that moves faster than {compiled.least_mps:.2g} m/s"
            raise InputRefused(recording.name, "poses", cause, "record a drive")
        noise = tune_noise(compiled, formulas, motion, forget_s)
    compiled = assume_noise(compiled, formulas, noise)
    track = filter_drive(compiled, formulas, drive, noise)
    if not math.isfinite(track.log_likelihood):
        cause = f"{', '.join(names)}: the filter leaves the finite numbers"
        raise InputRefused(recording.name, "poses", cause, "follow fewer quantities at once")
    return Adaptation(switched, quantities, formulas, compiled, noise, drive, track)


def filter_drive(f: CompiledFilter, formulas: AdaptiveFormulas, drive: MeasuredDrive, noise: FilterNoise) -> Track:
    """Run the filter `f` of `formulas`, which assumes `noise`, over the stretches of a drive.

    The car's state begins anew with each stretch; what is known of the quantities goes on, and fades over the gap.
    """
    estimate, n, K = drive.estimate, len(formulas.states), len(drive.estimate)
    q = np.array([each.start for each in formulas.quantities])
    P_0 = np.array([each.sd**2 for each in formulas.quantities])
    P_q, time_s, ended = np.diag(P_0), estimate.time_s, 0
    values, sd, innovation = np.tile(q, (K, 1)), np.tile(np.sqrt(np.diag(P_q)), (K, 1)), np.full((K, 3), np.nan)
    total = 0.0
    for rows in drive.stretches():
        first, after = rows.start, slice(rows.start + 1, rows.stop)
        delta = float(estimate.kinematic[first, 3])
        known = Knowledge(q, P_q, float(time_s[first] - time_s[ended]), float(time_s[first]))
        z, P = start_filter(formulas, noise, estimate.pose[first], estimate.twist[first], delta, known)
        run = run_filter(f, z, P, np.ascontiguousarray(estimate.command[rows][:-1]), drive.poses[after])
        q, P_q, ended = z[n:], P[n:, n:], rows.stop - 1
        values[after], innovation[after] = run.z[:, n:], run.innovation
        sd[after] = np.sqrt(np.maximum(run.variance[:, n:], 0.0))
        # until another stretch begins nothing more is learnt
        values[rows.stop :] = q
        kept = np.exp(-(time_s[rows.stop :, None] - time_s[ended]) / noise.forget_s)
        sd[rows.stop :] = np.sqrt(kept * np.maximum(np.diag(P_q), 0.0) + (1.0 - kept) * P_0)
        total += run.log_likelihood
    covariance = P_q.copy()
    forget(covariance, P_0, share_forgotten(float(time_s[-1] - time_s[ended]), noise))
    return Track(values, sd, innovation, total, covariance)


def tune_noise(f: CompiledFilter, formulas: AdaptiveFormulas, drive: MeasuredDrive, forget_s: float) -> FilterNoise:
    """The noise under which the poses of a drive are likeliest: pushes for the velocities, and those for the yaw rate.

    Of either there is one that is new in each period, and one that lasts.

    The drive's stretches are those in which the car moves.  The standard deviations of poses are those that the
    estimate's own filter was tuned to, where there was one.
    """
    from scipy.optimize import minimize

    twist = np.concatenate([drive.estimate.twist[rows] for rows in drive.stretches()])
    v_x, v_y, yaw_rate = np.sqrt((twist**2).mean(axis=0)).tolist()
    spread = np.array([max(v_x, v_y), max(v_x, v_y), yaw_rate])
    turned = max(float(np.sqrt((drive.estimate.kinematic[:, 3] ** 2).mean())), STEERING_SD_RAD)
    tuning = drive.estimate.tuning
    pose_sd = np.array([*2 * [tuning.noise.r_position], tuning.noise.r_yaw] if tuning else DEFAULT_POSE_SD)
    bounds = np.log(PUSH_RANGE)

    def assume(log_share: Floats) -> FilterNoise:
        velocity, turning, lasting, lasting_turn = np.exp(np.clip(log_share, *bounds)).tolist()
        q = spread * np.array([velocity, velocity, turning])
        d_x, d_y, d_turn = (spread * np.array([lasting, lasting, lasting_turn])).tolist()
        return FilterNoise(
            q, pose_sd, TWIST_SD_SHARE * spread, STEERING_SD_RAD, spread, turned, forget_s, (d_x, d_y, d_turn)
        )

    def minus_log_likelihood(log_share: Floats) -> float:
        noise = assume(log_share)
        total = filter_drive(assume_noise(f, formulas, noise), formulas, drive, noise).log_likelihood
        return -total if math.isfinite(total) else math.inf

    first = min((np.full(4, math.log(push)) for push in FIRST_PUSHES), key=minus_log_likelihood)
    found = minimize(minus_log_likelihood, first, method="Nelder-Mead", options={"xatol": 0.05, "fatol": 0.5})
    return assume(found.x)


def poses_at_rows(recording: Recording, estimate: Estimate) -> Floats:
    """The measured poses (K, 3) at the rows of an estimate, between the two next to each; NaN where there is none.

    A pose counts where these two are no farther apart than the estimate's period, or than three poses.
    """
    time_s, values = recording.poses.time_s, recording.poses.values
    rows = np.clip(np.searchsorted(time_s, estimate.time_s), 1, len(time_s) - 1)
    apart = time_s[rows] - time_s[rows - 1]
    within = (estimate.time_s >= time_s[rows - 1]) & (estimate.time_s <= time_s[rows])
    share = ((estimate.time_s - time_s[rows - 1]) / apart)[:, None]
    poses: Floats = (1.0 - share) * values[rows - 1] + share * values[rows]
    poses[~(within & (apart <= max(estimate.period_s, MAX_POSES_APART / recording.rate_hz)))] = np.nan
    return poses

"""Samples of takes for a fit: stretches that a model predicts from their start, and single steps."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.estimate.command_parts import join_parts, mean_commands
from bcid.estimate.types import Estimate
from bcid.models.limits import LIMITS


class Windows(NamedTuple):
    """B stretches of a take: `lags` rows before the start, the start, and the steps after it, oldest row first."""

    twist: Floats  # (B, lags + 1 + steps, 3)
    kinematic: Floats  # (B, lags + 1 + steps, 4)
    parts: Floats  # (B, lags + 1 + steps, W, 4), as in `Estimate`; the last row is not driven within the stretch
    lags: int

    @property
    def command(self) -> Floats:
        """The commands [u_s, u_m] (B, lags + 1 + steps, 2), averaged over each period."""
        return mean_commands(self.parts)

    @property
    def stretch_count(self) -> int:
        """The number of stretches, B."""
        return len(self.twist)

    @property
    def steps(self) -> int:
        """The number of steps after each start."""
        return int(self.twist.shape[1]) - 1 - self.lags


def cut_windows(estimates: Sequence[Estimate], steps: int, every: int, lags: int = 0) -> Windows:
    """Cut recordings' motion estimates into stretches of `steps` grid periods, starting `every` rows apart.

    Each includes `lags` rows before its start; none straddles two segments (uninterrupted runs of rows) or
    recordings.

    Raises:
        InputRefused: no segment is long enough for a stretch.
    """
    taken = []
    for e in estimates:
        for s in e.segments():
            rows = np.arange(s.start + lags, s.stop - steps, every)[:, None] + np.arange(-lags, steps + 1)
            if len(rows):
                taken.append((e.twist[rows], e.kinematic[rows], e.parts[rows]))
    if not taken:
        raise InputRefused(
            ", ".join(e.name for e in estimates) or "no recording",
            place="estimate",
            cause=f"no uninterrupted stretch holds {lags + 1 + steps} grid rows",
            next_step="use longer takes, a shorter horizon_s, or check the gaps listed by `bcid ingest`",
        )
    twist, kinematic, parts = zip(*taken, strict=True)
    return Windows(np.concatenate(twist), np.concatenate(kinematic), join_parts(parts), lags)


def stretch_spacing(estimates: Sequence[Estimate], steps: int) -> int:
    """Grid rows between the starts of stretches of `steps` periods on which a loss of rollouts is minimised.

    A stretch begins every tenth of its length, so that no single start, whose velocity is estimated with an error,
    weighs much: with stretches end to end the constants of a car depend on the row with which a take begins.  In long
    takes starts are farther apart, so that there are no more than LIMITS.max_stretches.
    """
    rows = sum(len(e) for e in estimates)
    return max(1, steps // LIMITS.starts_per_stretch, min(steps, -(-rows // LIMITS.max_stretches)))


def split_off_ends(
    estimates: Sequence[Estimate], min_rows: int, share: float | None = None
) -> tuple[list[Estimate], list[Estimate]]:
    """Split recordings for hold-out validation: all of them without their ends, and the ends that were split off.

    An end is the last `share` (LIMITS.validation_share if None) of a recording's grid rows, at least `min_rows`.  A
    recording shorter than LIMITS.min_ends_per_take such ends stays whole and gives none; if all do, both lists are
    the whole recordings.
    """
    share = LIMITS.validation_share if share is None else share
    beginnings, ends = list[Estimate](), list[Estimate]()
    for e in estimates:
        rows = max(min_rows, round(share * len(e)))
        if len(e) < LIMITS.min_ends_per_take * rows:
            beginnings.append(e)
            continue
        beginnings.append(e.select_rows(slice(0, len(e) - rows)))
        ends.append(e.select_rows(slice(len(e) - rows, len(e))))
    return (beginnings, ends) if ends else (list(estimates), list(estimates))


def loss_steps(loss: str, horizon_s: float, period_s: float) -> int:
    """Grid steps that a fit predicts from each start: 1 for the loss "one-step", else horizon_s / period_s (>= 2)."""
    return 1 if loss == "one-step" else max(2, round(horizon_s / period_s))


class SingleSteps(NamedTuple):
    """N samples k -> k+1; lagged arrays run from the newest row, k, to the oldest, k - lags."""

    twist: Floats  # (N, lags + 1, 3)
    command: Floats  # (N, lags + 1, 2), averaged over the period after each row
    kinematic: Floats  # (N, 4)
    next_twist: Floats  # (N, 3)
    next_kinematic: Floats  # (N, 4)

    @property
    def kinematic_inputs(self) -> Floats:
        """Inputs (N, 6) of the kinematic models' maps: [v_f, alpha_f, alpha_r, delta, u_s, u_m] at k, SI units."""
        return np.ascontiguousarray(np.column_stack([self.kinematic, self.command[:, 0]]))


def single_steps(estimates: Sequence[Estimate], lags: int = 0) -> SingleSteps:
    """Collect all pairs of neighbouring grid rows k, k+1 of the estimates as samples, with the `lags` rows before k.

    No sample straddles two segments (uninterrupted runs of rows) or recordings.

    Raises:
        InputRefused: no segment has the lags + 2 rows that a sample takes.
    """
    w, newest_first = cut_windows(estimates, 1, 1, lags), slice(lags, None, -1)
    return SingleSteps(
        w.twist[:, newest_first], w.command[:, newest_first], w.kinematic[:, lags], w.twist[:, -1], w.kinematic[:, -1]
    )


def column_spread(values: Floats) -> Floats:
    """Standard deviation (n,) of each column of `values` (N, n), for normalising; 1 where a column is constant."""
    sd = values.std(axis=0)
    return np.where(sd > 1e-9, sd, 1.0)


def inverse_spread(values: Floats) -> Floats:
    """Weights 1/sigma (n,) of errors in a normalised mean squared error; sigma by columns of `values` (N, n).

    sigma is the standard deviation.  The weight of a constant column is 1 (docs/errata.md row 12).
    """
    return 1.0 / column_spread(values)


def check_excitation(estimates: Sequence[Estimate]) -> None:
    """Refuse recordings from which a car's constants cannot be identified, since the car stands or never turns.

    The 95 % quantile of the speed must reach LIMITS.min_speed_mps, that of |yaw rate| LIMITS.min_yaw_rate_radps.

    Raises:
        InputRefused: one of them does not; the message names the constants that cannot be identified.
    """
    twist = np.concatenate([e.twist for e in estimates])
    speed = np.quantile(np.hypot(twist[:, 0], twist[:, 1]), LIMITS.excitation_quantile)
    yaw_rate = np.quantile(np.abs(twist[:, 2]), LIMITS.excitation_quantile)
    if speed < LIMITS.min_speed_mps:
        cause = "the car stands: K_t, R_1, R_2 and all others cannot be identified"
    elif yaw_rate < LIMITS.min_yaw_rate_radps:
        cause = "straight driving only: C_f, C_r, F_f_max, F_r_max and I_z cannot be identified"
    else:
        return
    next_step = "drive curves at several speeds (`bcid plan` writes commands), or add such a take"
    raise InputRefused(", ".join(e.name for e in estimates), "motion", cause, next_step)

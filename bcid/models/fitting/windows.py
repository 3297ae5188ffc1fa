"""Stretches of a take that a model predicts from their start: the samples of the multi-step loss."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate

HELD_OUT = 0.1  # of every take, its end: where networks choose their epoch, and from where process noise is found
LONG_ENOUGH = 4  # times its end, a take from which one is held out


class Windows(NamedTuple):
    """B stretches of `lags` rows before a start, the start, and the steps after it, oldest row first."""

    twist: Floats  # (B, lags + 1 + steps, 3)
    kinematic: Floats  # (B, lags + 1 + steps, 4)
    command: Floats  # (B, lags + 1 + steps, 2); the last row's is not driven within the stretch
    lags: int

    @property
    def number(self) -> int:
        """How many they are."""
        return len(self.twist)

    @property
    def steps(self) -> int:
        """Steps after each start."""
        return int(self.twist.shape[1]) - 1 - self.lags

    def part(self, rows: npt.NDArray[np.intp] | slice) -> Windows:
        """Some of the stretches."""
        return Windows(self.twist[rows], self.kinematic[rows], self.command[rows], self.lags)


def windows(estimates: Sequence[Estimate], steps: int, every: int, lags: int = 0) -> Windows:
    """Stretches of `steps`, one from each `every`-th row on; none straddles two segments or recordings.

    Raises:
        InputRefused: when no segment is long enough for one.
    """
    parts = [_of_segment(e, s, steps, every, lags) for e in estimates for s in e.segments()]
    parts = [p for p in parts if p.number]
    if not parts:
        raise InputRefused(
            ", ".join(e.name for e in estimates) or "no recording",
            place="estimate",
            cause=f"no uninterrupted stretch holds {lags + 1 + steps} grid rows",
            next_step="use longer takes, a shorter horizon_s, or check the gaps listed by `bcid ingest`",
        )
    twist, kinematic, command = (np.concatenate(column) for column in list(zip(*parts, strict=True))[:3])
    return Windows(twist, kinematic, command, lags)


def _of_segment(e: Estimate, s: slice, steps: int, every: int, lags: int) -> Windows:
    starts = np.arange(s.start + lags, s.stop - steps, every)
    rows = starts[:, None] + np.arange(-lags, steps + 1)
    return Windows(e.twist[rows], e.kinematic[rows], e.command[rows], lags)


def divided(
    estimates: Sequence[Estimate], least: int, share: float = HELD_OUT
) -> tuple[list[Estimate], list[Estimate]]:
    """The takes without their ends, and the ends: a `share` of each take, `least` rows of it where that is more.

    Where no take is four times as long as that, there is nothing to spare: all of them are both.
    """
    kept, held = list[Estimate](), list[Estimate]()
    for e in estimates:
        rows = max(least, round(share * len(e)))
        if len(e) < LONG_ENOUGH * rows:
            kept.append(e)
            continue
        kept.append(e.part(slice(0, len(e) - rows)))
        held.append(e.part(slice(len(e) - rows, len(e))))
    return (kept, held) if held else (list(estimates), list(estimates))


def steps_of(loss: str, horizon_s: float, period_s: float) -> int:
    """The steps from each start that a loss counts: one, or those of the horizon."""
    return 1 if loss == "one-step" else max(2, round(horizon_s / period_s))


class Transitions(NamedTuple):
    """N one-step samples k -> k+1; lagged arrays run from the newest row (k) to the oldest (k - lags)."""

    twist: Floats  # (N, lags + 1, 3)
    command: Floats  # (N, lags + 1, 2)
    kinematic: Floats  # (N, 4)
    next_twist: Floats  # (N, 3)
    next_kinematic: Floats  # (N, 4)


def transitions(estimates: Sequence[Estimate], lags: int = 0) -> Transitions:
    """Every one-step sample with `lags` rows before it; none straddles two segments or recordings.

    Raises:
        InputRefused: when no segment is long enough for one sample.
    """
    w, newest_first = windows(estimates, 1, 1, lags), slice(lags, None, -1)
    return Transitions(
        w.twist[:, newest_first], w.command[:, newest_first], w.kinematic[:, lags], w.twist[:, -1], w.kinematic[:, -1]
    )


def spread(values: Floats) -> Floats:
    """The standard deviation of each column; of a constant one, 1."""
    sd = values.std(axis=0)
    return np.where(sd > 1e-9, sd, 1.0)


def scale(values: Floats) -> Floats:
    """The diagonal of W: 1/sigma of each column (errata 12); a constant column keeps weight 1."""
    return 1.0 / spread(values)


LEAST_SPEED = 0.05  # m/s


LEAST_YAW_RATE = 0.02  # rad/s


OF_MOTION = "K_t, R_1, R_2 and all others"


OF_TURNING = "C_f, C_r, F_f_max, F_r_max and I_z"


def check_excited(estimates: Sequence[Estimate]) -> None:
    """Raise `InputRefused`, naming the constants, where no fit could find them: the car stands, or never turns."""
    twist = np.concatenate([e.twist for e in estimates])
    speed, yaw_rate = np.quantile(np.hypot(twist[:, 0], twist[:, 1]), 0.95), np.quantile(np.abs(twist[:, 2]), 0.95)
    place, next_step = "motion", "drive curves at several speeds (`bcid plan` writes commands), or add such a take"
    names = ", ".join(e.name for e in estimates)
    if speed < LEAST_SPEED:
        raise InputRefused(names, place, f"the car stands: {OF_MOTION} cannot be identified", next_step)
    if yaw_rate < LEAST_YAW_RATE:
        raise InputRefused(names, place, f"straight driving only: {OF_TURNING} cannot be identified", next_step)

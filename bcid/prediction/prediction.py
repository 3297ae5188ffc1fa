"""What a model predicts: pose and twist over time with their covariance, and where that leaves what the model knows."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.estimate.command_parts import mean_commands
from bcid.evaluation.noise_covariance import NORMAL_FACTOR, noise_covariance, predict_motion
from bcid.evaluation.process_noise import ProcessNoise
from bcid.evaluation.validity import STEERED, ModelValidity
from bcid.files.outputs import write_output
from bcid.models.interface import Model
from bcid.models.limits import LIMITS
from bcid.prediction.constants import vary_constants
from bcid.prediction.covariance import constants_covariance, start_covariance
from bcid.prediction.start import InitialState
from bcid.prediction.table import check_ending, write_prediction_table

CONDITION = "it holds as far as the vehicle drives as it did in the takes that the model was fitted on"


class BeyondData(UserWarning):
    """Commands or motion leave the range of the data that a model was fitted on: it extrapolates from there on."""


@dataclass(frozen=True)
class Prediction:
    """Pose and twist of the tracked point that a model predicts, one row a period, with their covariance.

    `exits` says, once for each quantity, where motion or commands leave the range of the data that the model was fitted
    on.  `sources` are what the covariance is made of, `caveats` what it lacks.
    """

    time_s: Floats  # (T,) s: of the take for a moment of a recording, else from zero
    pose: Floats  # (T, 3) x m, y m (world), yaw rad (continuous)
    twist: Floats  # (T, 3) v_x m/s, v_y m/s (body), yaw rate rad/s
    covariance: Floats  # (T, 6, 6) of pose and twist; NaN from where on errors run away
    sources: tuple[str, ...] = ()
    caveats: tuple[str, ...] = ()
    exits: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def sd(self) -> Floats:
        """Standard deviations (T, 6) of pose and twist."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def half_width(self) -> Floats:
        """Half widths (T, 6) of the 95 % intervals of pose and twist: 1.96 standard deviations."""
        return NORMAL_FACTOR * self.sd

    @property
    def interval(self) -> tuple[Floats, Floats]:
        """Lower and upper ends (T, 6) of the 95 % intervals of pose and twist, each for itself."""
        middle, half = np.hstack([self.pose, self.twist]), self.half_width
        return middle - half, middle + half

    def describe_covariance(self) -> str:
        """What the covariance is made of and what it lacks, in a sentence for people."""
        made_of = ", ".join(self.sources) or "nothing that is known"
        return f"the covariance is of {made_of}; {'; '.join([*self.caveats, CONDITION])}"

    def write(self, path: Path | str, *, force: bool = False) -> None:
        """Write all rows as CSV or Parquet, by the ending of the path; units stand in the names of the columns.

        The file appears whole or not at all; `force` lets it replace one that is there already.

        Raises:
            UsageError: the ending is another one.
            InputRefused: a file is there already and may not be replaced, or the folder cannot be written to.
        """
        target = Path(path)
        check_ending(target)
        other = "name another file, or replace this one by force=True"
        if not force and os.path.lexists(target):
            raise InputRefused(target, "output", "exists already and would be overwritten", other)
        write_output(target, self.write_rows, lambda there: force, other)

    def write_rows(self, path: Path) -> None:
        """Write the table to a new file, which whoever calls it moves to its place."""
        write_prediction_table(path, self.time_s, self.pose, self.twist, self.covariance, self.interval)


def predict_from(
    model: Model, validity: ModelValidity | None, start: InitialState, parts: Floats, source: str
) -> Prediction:
    """Predict pose and twist, with their covariance, from a start under the commands `parts` (N, W, 4).

    The covariance is that of the start, of the constants as well as the model states them, and of its process noise
    where `validity` knows it; `source` is the model's name in messages.

    Raises:
        InputRefused: the prediction leaves the motion that any ground vehicle can have.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        motion = predict_motion(model, start.history, parts)
        diverged = ~(np.abs(motion[:, 3:]) <= LIMITS.fastest_twist).all(axis=1)
        if diverged.any():
            at = f"{int(np.argmax(diverged)) * model.period_s:g} s"
            cause = "the prediction runs away there"
            raise InputRefused(source, at, cause, "predict less, or drive it as in the takes that it was fitted on")
        varied = vary_constants(model)
        noise = validity.noise if validity else None
        covariance = start_covariance(model, start, parts)
        covariance += constants_covariance(varied, start.history, parts)
        if noise is not None:
            share = _tail_factors(noise)
            covariance += noise_covariance(model, start.history, parts, noise) * np.outer(share, share)
    # an error that is not finite once is not known any more later
    covariance[np.cumsum(~np.isfinite(covariance).all(axis=(1, 2))) > 0] = np.nan
    sources = {
        "the start": bool(start.spread.any()),
        "the constants": bool(varied.variations),
        "what the model lacks in its own takes (process noise)": noise is not None,
    }
    caveats = {
        "no process noise is known of this model": noise is None,
        "how far its poses go astray is not calibrated": noise is not None and noise.pose_factor is None,
        f"the errors of {', '.join(varied.left_out)} are not known": bool(varied.left_out),
        "from a time on the errors run away, and no covariance is stated": bool(np.isnan(covariance).any()),
    }
    return Prediction(
        start.time_s + model.period_s * np.arange(len(motion), dtype=np.float64),
        motion[:, :3],
        motion[:, 3:],
        covariance,
        tuple(text for text, holds in sources.items() if holds),
        tuple(text for text, holds in caveats.items() if holds),
        _describe_exits(model, validity, motion[:, 3:], parts, start),
    )


def _tail_factors(noise: ProcessNoise) -> Floats:
    """Factors (6,) on standard deviations of pose and twist by process noise, so that 1.96 of them hold 95 %.

    Errors of an incomplete model have other tails than the normal law, which its calibration measures.
    """
    pose = noise.factor if noise.pose_factor is None else noise.pose_factor
    return np.array([pose] * 3 + [noise.factor] * 3) / NORMAL_FACTOR


def _describe_exits(
    model: Model, validity: ModelValidity | None, twist: Floats, parts: Floats, start: InitialState
) -> tuple[str, ...]:
    """Where the start, twists (N + 1, 3) or commands first leave the model's data, in words, once for each quantity.

    The times in them count as those of the prediction do, which begins at that of the `start`.
    """
    if validity is None:
        return ()
    driven = mean_commands(parts)
    steered = [e for e in validity.range.start_exits(twist[0], start.steering_angle) if e.quantity == STEERED]
    exits = [*steered, *validity.range.first_exits(twist, np.vstack([driven, driven[-1:]]))]
    first = round(start.time_s / model.period_s)
    return tuple(e._replace(step=first + e.step).describe(model.period_s) for e in exits)

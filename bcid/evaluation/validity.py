"""What is known of a fitted model's validity, saved beside it: its process noise and the range of its training data.

Beyond the range of motion and commands that a model was fitted on, a rollout extrapolates.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field, ValidationError, field_validator

from bcid.aliases import Bools, Floats
from bcid.documents.document import Document, describe_problems
from bcid.documents.report import ProcessNoiseFigures
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.evaluation.limits import LIMITS
from bcid.evaluation.noise_covariance import calibrate_pose_factor
from bcid.evaluation.process_noise import ProcessNoise, calibrate_process_noise
from bcid.files.json import read_json, write_json
from bcid.models.interface import Model

FILE_NAME = "limits.json"
QUANTITIES = {
    "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s", "v_x yaw_rate": "m/s²", "u_s": "rad", "u_m": ""
}  # fmt: skip


STEERED = "delta"
"""The steering angle of a start, which no command led to; it is compared with the range of the steering command u_s."""


class RangeExit(NamedTuple):
    """Where a rollout first leaves the range of one quantity."""

    step: int
    quantity: str
    value: float
    limit: float

    def describe(self, period_s: float) -> str:
        """The exit in words, with its time for steps of `period_s`."""
        unit, side = (QUANTITIES | {STEERED: "rad"})[self.quantity], "up to" if self.value > self.limit else "down to"
        value, limit = (f"{v:.3g} {unit}".strip() for v in (self.value, self.limit))
        return f"{self.quantity} is {value} at {self.step * period_s:.1f} s, the takes go {side} {limit}"


class DataRange(NamedTuple):
    """Lowest and highest value of each of QUANTITIES."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def from_estimates(cls, estimates: Sequence[Estimate]) -> DataRange:
        """The range that the takes cover together."""
        table = np.concatenate([_quantity_table(e.twist, e.command) for e in estimates])
        return cls(tuple(table.min(axis=0).tolist()), tuple(table.max(axis=0).tolist()))

    def first_exits(self, twist: Floats, command: Floats) -> list[RangeExit]:
        """Where a rollout first leaves the range, by quantity in order of time; twist (N, 3), command (N, 2)."""
        table, low, high = _quantity_table(twist, command), np.array(self.low), np.array(self.high)
        outside, exits = self._is_outside(table), []
        for c in np.flatnonzero(outside.any(axis=0)):
            k = int(np.argmax(outside[:, c]))
            value = float(table[k, c])
            exits.append(RangeExit(k, list(QUANTITIES)[c], value, float(high[c] if value > high[c] else low[c])))
        return sorted(exits)

    def start_exits(self, twist: Floats, delta: float) -> list[RangeExit]:
        """What of a start is outside the range: its twist (3,), or the angle `delta` (rad) that is steered there."""
        of_command = list(QUANTITIES).index("u_s")
        u_m = 0.5 * (self.low[of_command + 1] + self.high[of_command + 1])
        exits = self.first_exits(twist[None], np.array([[delta, u_m]]))
        return [e._replace(quantity=STEERED) if e.quantity == "u_s" else e for e in exits]

    def share_outside(self, twist: Floats, command: Floats) -> float:
        """The share of rows of a motion at which any quantity is outside the range; twist (N, 3), command (N, 2)."""
        return float(self._is_outside(_quantity_table(twist, command)).any(axis=1).mean())

    def _is_outside(self, table: Floats) -> Bools:
        """Which values of a table (N, 6) of QUANTITIES lie outside the range by more than the margin."""
        low, high = np.array(self.low), np.array(self.high)
        margin = LIMITS.range_margin * (high - low)
        return np.asarray((table < low - margin) | (table > high + margin))


def _quantity_table(twist: Floats, command: Floats) -> Floats:
    """Table (N, 6) of the quantities whose range in the training data bounds a model's validity.

    Its columns are v_x, v_y, yaw rate, v_x times yaw rate, u_s, u_m, from twists (N, 3) and commands (N, 2).
    """
    return np.column_stack([twist, twist[:, 0] * twist[:, 2], command])


class _ValidityDocument(Document):
    """The whole of limits.json."""

    kind: Literal["bcid.limits/1"] = Field("bcid.limits/1", alias="schema")
    process_noise: ProcessNoiseFigures | None  # null where no take was long enough, or the model runs away
    range: dict[str, tuple[float, float]]  # lowest and highest value of each of QUANTITIES

    @field_validator("range")
    @classmethod
    def _check_range(cls, ranges: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """Refuse a range that lacks a quantity, or is upside down."""
        for name in QUANTITIES:
            if name not in ranges:
                raise ValueError(f"lacks {name}")
            if not ranges[name][0] <= ranges[name][1]:
                raise ValueError(f"{name} is lowest at {ranges[name][0]:g} and highest at {ranges[name][1]:g}")
        return ranges


class ModelValidity(NamedTuple):
    """How far the predictions of one fitted model can be trusted, and over which motion and commands."""

    noise: ProcessNoise | None  # None where no take was long enough, or the model runs away
    range: DataRange

    @classmethod
    def measure(cls, model: Model, estimates: Sequence[Estimate], seed: int) -> ModelValidity:
        """The validity of a model that was fitted to `estimates`; `seed` is that of the noise samples."""
        noise = calibrate_process_noise(model, estimates, seed)
        noise = noise and noise._replace(pose_factor=calibrate_pose_factor(model, estimates, noise))
        return cls(noise, DataRange.from_estimates(estimates))

    def save(self, folder: Path) -> None:
        """Write limits.json beside the model in `folder`."""
        noise = self.noise and ProcessNoiseFigures(**self.noise._asdict())
        ranges = dict(zip(QUANTITIES, zip(*self.range, strict=True), strict=True))
        write_json(folder / FILE_NAME, _ValidityDocument(process_noise=noise, range=ranges).as_json())


def load_validity(folder: Path) -> ModelValidity | None:
    """Read a model's process noise and data range from limits.json in its `folder`; None where there is no such file.

    Raises:
        InputRefused: limits.json cannot be read.
    """
    path = folder / FILE_NAME
    if not path.exists():
        return None
    try:
        document = _ValidityDocument.from_json(json.dumps(read_json(path)))
    except ValidationError as error:
        places, causes = describe_problems(error, _ValidityDocument)
        raise InputRefused(path, places, causes, "fit the model again, or remove the file") from None
    except (OSError, ValueError) as error:
        raise InputRefused(path, FILE_NAME, f"cannot be read: {error}", "fit the model again, or remove it") from None
    low, high = zip(*(document.range[name] for name in QUANTITIES), strict=True)
    figures = document.process_noise
    noise = ProcessNoise(**figures.model_dump()) if figures else None
    return ModelValidity(noise, DataRange(low, high))

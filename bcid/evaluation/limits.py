"""What is known of a fitted model's limits, saved beside it: its process noise and the range it was fitted on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.evaluation.data_range import QUANTITIES, DataRange
from bcid.evaluation.uncertainty import ProcessNoise, calibrated
from bcid.files.json import read_json, write_json
from bcid.models.interface import Model

FILE = "limits.json"
SCHEMA = "bcid.limits/1"


class Limits(NamedTuple):
    """Of one model."""

    noise: ProcessNoise | None  # None where no take was long enough
    range: DataRange

    @classmethod
    def of(cls, model: Model, estimates: Sequence[Estimate], seed: int) -> Limits:
        """Those of a model fitted on the takes."""
        return cls(calibrated(model, estimates, seed), DataRange.of(estimates))

    def as_json(self) -> dict[str, Any]:
        """As it is saved."""
        return {
            "schema": SCHEMA,
            "process_noise": self.noise and self.noise._asdict(),
            "range": dict(zip(QUANTITIES, zip(*self.range, strict=True), strict=True)),
        }

    def save(self, folder: Path) -> None:
        """Write it beside the model in `folder`."""
        write_json(folder / FILE, self.as_json())


def load_limits(folder: Path) -> Limits | None:
    """The limits saved beside the model in `folder`; None where there are none.

    Raises:
        InputRefused: a file that holds something else.
    """
    path = folder / FILE
    if not path.exists():
        return None
    try:
        data = read_json(path)
        if data["schema"] != SCHEMA:
            raise ValueError(f"is {data['schema']!r}, not {SCHEMA}")
        noise, range_ = data["process_noise"], data["range"]
        low, high = (tuple(_finite(range_[name][i]) for name in QUANTITIES) for i in (0, 1))
        if noise is None:
            return Limits(None, DataRange(low, high))
        x, y, z = (_finite(v) for v in noise["q"])
        return Limits(ProcessNoise((x, y, z), _finite(noise["tau_s"]), _finite(noise["factor"])), DataRange(low, high))
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputRefused(
            path, FILE, f"cannot be read: {error!r}", "fit the model again, or remove the file"
        ) from None


def _finite(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r} is no finite number")
    return float(value)

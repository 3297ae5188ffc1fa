"""What a report says, before it is drawn: models best first, and the paper's own table."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.evaluation.judge import ROWS
from bcid.files.parquet import read_columns

PAPER_TABLE = (
    ("newton-euler", 5.973, 303.7),
    ("narx-mlp", 5.587, 76.2),
    ("k-mlp", 4.594, 85.6),
    ("k-sindy", 12.960, 37.1),
    ("k-sindy-mlp", 4.765, 81.1),
)
"""Model, NMSE x 10^3, ms: the paper's Table `runtimes`, on other data and another machine."""


@dataclass(frozen=True)
class ModelResult:
    """One model's figures, and its predictions on the validation take."""

    figures: Mapping[str, Any]
    settings: Mapping[str, Any]
    twist: Floats  # (K, 3) through the whole take
    restart_pose: Floats  # (K, 3)
    restart_twist: Floats  # (K, 3)
    restart: npt.NDArray[np.bool_]  # (K,)
    half: Floats  # (K, 3) half widths of the whole rollout's 95 % interval, NaN where none is known

    @property
    def name(self) -> str:
        """The model's name."""
        return str(self.figures["model"])

    @classmethod
    def read(cls, figures: Mapping[str, Any], settings: Mapping[str, Any], folder: Path) -> ModelResult:
        """With the rows of an evaluation's folder."""
        rows = read_columns(folder / "rows.parquet", ROWS)
        return cls(figures, settings, rows[:, :3], rows[:, 3:6], rows[:, 6:9], rows[:, 9] > 0.5, rows[:, 10:13])


class TakeFacts(NamedTuple):
    """What is told of one take: its recording, its estimate, and the check where there is a truth."""

    recording: Mapping[str, Any]
    estimate: Mapping[str, Any]
    check: Mapping[str, Any] | None


@dataclass(frozen=True)
class Content:
    """All that the page is made of."""

    vehicle: str
    validation: Estimate
    models: Sequence[ModelResult]
    takes: Sequence[TakeFacts]
    restart_s: float
    diagnosis: Mapping[str, Any] | None = None  # diagnosis.json of the plan's last stage
    losses: Sequence[Mapping[str, Any]] = ()  # figures of models fitted by several losses, with the same seed

    def ranked(self) -> list[ModelResult]:
        """Best first; diverged ones last."""
        return sorted(self.models, key=lambda m: m.figures["nmse"] if m.figures["nmse"] is not None else np.inf)


def machine() -> dict[str, Any]:
    """The machine that the times were taken on, as far as it may be told."""
    import os

    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "unknown"


def report_json(content: Content) -> dict[str, Any]:
    """`bcid.report/1` (contracts)."""
    take = content.validation
    keys = (
        "model", "nmse", "nmse_ci95", "nmse_vx", "nmse_vy", "nmse_yaw_rate", "nmse_restarted", "end_miss_m",
        "rollout_ms", "parameters", "process_noise", "coverage", "take_outside_range", "beyond",
    )  # fmt: skip
    return {
        "schema": "bcid.report/1",
        "vehicle": content.vehicle,
        "validation": {
            "name": take.name,
            "duration_s": float(take.time_s[-1] - take.time_s[0]),
            "period_s": take.period_s,
            "samples": len(take),
            "segments": len(take.segments()),
        },
        "weights": dict(zip(("v_x", "v_y", "yaw_rate"), content.models[0].figures["weights"], strict=True)),
        "restart_s": content.restart_s,
        "machine": machine(),
        "models": [{k: m.figures[k] for k in keys} for m in content.ranked()],
        "losses": list(content.losses),
        "diagnosis": content.diagnosis and _verdict(content.diagnosis),
    }


def _verdict(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """A diagnosis in short."""
    from bcid.report.diagnosis_page import verdict_sentence

    effects = [f["effect"] for f in diagnosis["findings"]]
    return {
        "verdict": diagnosis["verdict"], "effects": effects, "recordings": diagnosis["recordings"],
        "sentence": verdict_sentence(diagnosis),
    }  # fmt: skip

"""One model's figures on the validation take, and the rows that plots are drawn from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import misses, restarted, whole_take
from bcid.evaluation.limits import Limits
from bcid.evaluation.nmse import nmse
from bcid.evaluation.uncertainty import coverage, half_widths
from bcid.files.parquet import write_columns
from bcid.models.fitting.windows import scale
from bcid.models.interface import Model

ROWS = {
    "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s",
    "restart_x": "m", "restart_y": "m", "restart_yaw": "rad",
    "restart_v_x": "m/s", "restart_v_y": "m/s", "restart_yaw_rate": "rad/s", "restart": "1",
    "half_v_x": "m/s", "half_v_y": "m/s", "half_yaw_rate": "rad/s",
}  # fmt: skip


def judge(
    model: Model,
    validation: Estimate,
    training: Sequence[Estimate],
    every_s: float,
    folder: Path,
    limits: Limits | None = None,
) -> dict[str, Any]:
    """Write evaluation.json and rows.parquet into `folder`; returns the figures.

    NMSE against the smoothed estimate from the first sample on, W = 1/sigma of the training takes.
    """
    weights = scale(np.concatenate([e.twist for e in training]))
    twist, again = whole_take(model, validation), restarted(model, validation, every_s)
    miss = misses(model, validation, every_s)
    finite = bool(np.isfinite(twist).all())
    whole = nmse(twist, validation.twist, weights, validation.period_s) if finite else None
    short = (
        nmse(again.twist, validation.twist, weights, validation.period_s) if np.isfinite(again.twist).all() else None
    )
    figures = {
        "model": model.name,
        "nmse": whole and whole.mean,
        "nmse_ci95": whole and list(whole.ci95),
        "nmse_vx": whole and whole.v_x,
        "nmse_vy": whole and whole.v_y,
        "nmse_yaw_rate": whole and whole.yaw_rate,
        "nmse_restarted": short and short.mean,
        "end_miss_m": float(np.median(miss)) if len(miss) and np.isfinite(np.median(miss)) else None,
        "parameters": model.parameter_count,
        **_how_sure(model, validation, twist, limits),
        "weights": weights.tolist(),
        "description": model.describe(),
    }
    (folder / "evaluation.json").write_text(json.dumps(figures, indent=1, ensure_ascii=False), encoding="utf-8")
    half = half_widths(model, validation, limits.noise if limits else None)
    rows = np.column_stack([twist, again.pose, again.twist, again.start, half])
    write_columns(folder / "rows.parquet", rows, ROWS)
    return figures


def _how_sure(model: Model, take: Estimate, twist: Floats, limits: Limits | None) -> dict[str, Any]:
    """The process noise, how often its intervals hold on the take, and where the rollout leaves the data's range."""
    if limits is None:
        return {"process_noise": None, "coverage": None, "take_outside_range": None, "beyond": None}
    finite = bool(np.isfinite(twist).all())
    beyond = [b.words(take.period_s) for b in limits.range.beyond(twist, take.command)] if finite else ["it diverges"]
    return {
        "process_noise": limits.noise and limits.noise._asdict(),
        "coverage": coverage(model, take, limits.noise) if limits.noise else None,
        "take_outside_range": limits.range.share_outside(take.twist, take.command),
        "beyond": beyond,
    }

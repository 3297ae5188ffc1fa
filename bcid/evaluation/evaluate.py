"""The scores of one fitted model on the validation take, and the rows that plots are drawn from."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.documents.report import EvaluationDocument, ProcessNoiseFigures
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import nmse, position_errors, predict_whole_take, predict_with_restarts
from bcid.evaluation.intervals import interval_half_widths, measure_coverage
from bcid.evaluation.validity import ModelValidity
from bcid.files.parquet import write_columns
from bcid.models.fitting.windows import inverse_spread
from bcid.models.interface import Model

ROW_UNITS = {
    "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s",
    "restart_x": "m", "restart_y": "m", "restart_yaw": "rad",
    "restart_v_x": "m/s", "restart_v_y": "m/s", "restart_yaw_rate": "rad/s", "restart": "1",
    "half_v_x": "m/s", "half_v_y": "m/s", "half_yaw_rate": "rad/s",
}  # fmt: skip


def evaluate_model(
    model: Model, validation: Estimate, training: Sequence[Estimate], every_s: float, folder: Path,
    validity: ModelValidity | None,
) -> EvaluationDocument:  # fmt: skip
    """Score a model's predictions of the validation take; write evaluation.json and rows.parquet into `folder`.

    The scores are the NMSE of rollouts from each segment's start and of those restarted every `every_s` seconds, with
    weights 1/sigma of the `training` twists (docs/errata.md row 12), the position error after `every_s`, and the
    coverage of 95 % intervals.  Intervals, and exits from the training range, need `validity`: the model's process
    noise and data range.
    """
    weights = inverse_spread(np.concatenate([e.twist for e in training]))
    twist, again = predict_whole_take(model, validation), predict_with_restarts(model, validation, every_s)
    miss = position_errors(model, validation, every_s)
    whole, short = (
        nmse(predicted, validation.twist, weights, validation.period_s) if np.isfinite(predicted).all() else None
        for predicted in (twist, again.twist)
    )
    evaluation = EvaluationDocument(
        model=model.name,
        nmse=whole and whole.mean,
        nmse_ci95=whole and whole.ci95,
        nmse_vx=whole and whole.v_x,
        nmse_vy=whole and whole.v_y,
        nmse_yaw_rate=whole and whole.yaw_rate,
        nmse_restarted=short and short.mean,
        end_miss_m=float(np.median(miss)) if len(miss) else None,
        parameters=model.parameter_count,
        **_uncertainty_figures(model, validation, twist, validity),
        weights=tuple(weights.tolist()),
        description=model.describe(),
    )
    evaluation.write(folder / "evaluation.json")
    half = interval_half_widths(model, validation, validity.noise if validity else None)
    rows = np.column_stack([twist, again.pose, again.twist, again.start, half])
    write_columns(folder / "rows.parquet", rows, ROW_UNITS)
    return evaluation


def _uncertainty_figures(model: Model, take: Estimate, twist: Floats, validity: ModelValidity | None) -> dict[str, Any]:
    """Fields of evaluation.json: process noise, coverage of 95 % intervals, and exits from the training data's range.

    The exits are those of the prediction `twist` (K, 3) of the take; the share outside the range is that of its
    measured motion.  Empty where `validity` is None.
    """
    if validity is None:
        return {}
    exits = validity.range.first_exits(twist, take.command) if np.isfinite(twist).all() else None
    return {
        "process_noise": validity.noise and ProcessNoiseFigures(**validity.noise._asdict()),
        "coverage": measure_coverage(model, take, validity.noise) if validity.noise else None,
        "take_outside_range": validity.range.share_outside(take.twist, take.command),
        "beyond": ["it diverges"] if exits is None else [e.describe(take.period_s) for e in exits],
    }

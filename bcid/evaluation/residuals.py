"""How far a fitted model's residuals exceed what the measurement explains, saved beside the model as residuals.json.

Standard errors of constants hold if the model lacks nothing.  Whether it does show the errors of its predictions of
the takes that it was fitted on: after `HORIZON_S`, a model that lacks nothing is off by what the start and the end were
measured wrongly,

    e = f(x_0) - y,   V = J diag(s_0^2) J^T + diag(s_1^2),   ratio = sqrt(mean(e^2 / diag(V))),

with s_0 and s_1 the standard deviations of the smoothed motion at start and end, J = df/dx_0.  These are
larger than the smoother's errors, since it takes the car for a random walk, so that a model that lacks nothing has a
ratio not of 1, but of LIMITS.usual_residual_ratio.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from bcid.aliases import Floats
from bcid.documents.document import Document, Number
from bcid.errors import InputRefused
from bcid.estimate.command_parts import stack_parts
from bcid.estimate.types import Estimate
from bcid.evaluation.limits import LIMITS
from bcid.evaluation.process_noise import PredictionStart, list_prediction_starts
from bcid.files.json import read_json, write_json
from bcid.models.interface import History, Model, history_at

FILE_NAME = "residuals.json"
HORIZON_S = 1.0
# By name, so that the key of another model's fit does not hang on the code of cars.
CARS = ("newton-euler", "newton-euler-linear")


class ResidualsDocument(Document):
    """The whole of residuals.json: how far a model's residuals on its training takes exceed the measurement's noise."""

    kind: Literal["bcid.residuals/1"] = Field("bcid.residuals/1", alias="schema")
    horizon_s: float
    predictions: int
    ratio: Number  # null but of cars without effects, and where no take is long enough or predictions run away

    @property
    def multiple(self) -> float:
        """How many times larger the residuals are than those of a model that lacks nothing; NaN where nobody knows."""
        return math.nan if self.ratio is None else self.ratio / LIMITS.usual_residual_ratio

    @property
    def show_missing_physics(self) -> bool:
        """Whether the residuals are larger than chance makes those of a model that lacks nothing."""
        return self.multiple > LIMITS.max_residual_multiple


def measure_residuals(model: Model, estimates: Sequence[Estimate]) -> ResidualsDocument:
    """How a model's prediction errors after HORIZON_S, in the takes it was fitted on, compare with the measurement.

    Only of cars without effects, which start from the twist and the steering angle of one row, is it known what errors
    of the start make; other models start from slip angles, or from many rows, and have no ratio.
    """
    steps = max(1, round(HORIZON_S / model.period_s))
    starts = list_prediction_starts(estimates, steps, steps, model.lags) if model.name in CARS else []
    ratio = _residual_ratio(model, starts, steps) if starts else math.nan
    return ResidualsDocument(horizon_s=steps * model.period_s, predictions=len(starts), ratio=ratio)


def _residual_ratio(model: Model, starts: Sequence[PredictionStart], steps: int) -> float:
    """Root mean square of the prediction errors over their standard deviations, for predictions of `steps` steps."""
    histories = [history_at(e, k, model.lags) for e, k in starts]
    commands = stack_parts([e.parts[k : k + steps] for e, k in starts])
    predicted = _predict_ends(model, histories, commands)
    measured = np.stack([e.twist[k + steps] for e, k in starts])
    variance = np.stack([e.twist_sd[k + steps] ** 2 for e, k in starts])
    for j in range(4):
        sd = np.array([e.twist_sd[k, j] if j < 3 else e.kinematic_sd[k, 3] for e, k in starts])
        moved = [_move_start(h, j, s) for h, s in zip(histories, sd, strict=True)]
        variance += (_predict_ends(model, moved, commands) - predicted) ** 2
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean((predicted - measured) ** 2 / variance)))


def _move_start(history: History, j: int, by: float) -> History:
    """A history whose last row's twist component `j` (0 to 2), or steering angle (j = 3), is larger by `by`."""
    twist, kinematic = history.twist.copy(), history.kinematic.copy()
    if j < 3:
        twist[-1, j] += by
    else:
        kinematic[-1, 3] += by
    return replace(history, twist=twist, kinematic=kinematic)


def _predict_ends(model: Model, histories: Sequence[History], commands: Floats) -> Floats:
    """Twists (B, 3) that a model predicts at the end of the commands, parts (B, N, W, 4), after each of B histories."""
    carries = np.stack([model.init(h) for h in histories])
    return np.asarray(model.scan_many(carries, commands)[1][:, -1])


def save_residuals(document: ResidualsDocument, folder: Path) -> None:
    """Write residuals.json beside the model in `folder`."""
    write_json(folder / FILE_NAME, document.as_json())


def load_residuals(folder: Path) -> ResidualsDocument | None:
    """Read residuals.json beside the model in `folder`; None where there is no such file.

    Raises:
        InputRefused: it cannot be read.
    """
    path = folder / FILE_NAME
    if not path.exists():
        return None
    try:
        return ResidualsDocument.from_json(json.dumps(read_json(path)))
    except (OSError, ValueError) as error:
        next_step = "fit the model again, or remove the file"
        raise InputRefused(path, FILE_NAME, f"cannot be read: {error}", next_step) from None

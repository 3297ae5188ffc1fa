"""The covariance of a prediction, by linearisation about it.

A predicted motion y (pose and twist at all times) depends on the state s that it starts from, on the model's constants
c, and on what the model lacks, which pushes the motion at each step (w, `bcid.evaluation.noise_covariance`):

    P(t) = J_s P_s J_s^T + J_c P_c J_c^T + J_w P_w J_w^T.

Each column of the J times its standard deviation is found by predicting twice, with the number raised and lowered by
one standard deviation, and halving the difference.  So errors add up linearly, as they do while they are small beside
the motion itself; the test beside this module draws them at random instead, and finds the same covariance.
"""

from __future__ import annotations

import numpy as np

from bcid.aliases import Floats
from bcid.evaluation.noise_covariance import predict_motion
from bcid.models.interface import History, Model
from bcid.prediction.constants import VariedConstants
from bcid.prediction.start import InitialState


def start_covariance(model: Model, start: InitialState, parts: Floats) -> Floats:
    """Covariance (N + 1, 6, 6) that errors of the start make in the motion under commands `parts` (N, W, 4)."""
    columns = [
        0.5 * (predict_motion(model, start.shift(e), parts) - predict_motion(model, start.shift(-e), parts))
        for e in start.spread
        if e.any()
    ]
    return _sum_of_squares(columns, len(parts) + 1)


def constants_covariance(varied: VariedConstants, history: History, parts: Floats) -> Floats:
    """Covariance (N + 1, 6, 6) that errors of the model's constants make in the motion under `parts` (N, W, 4)."""
    if not varied.variations:
        return np.zeros((len(parts) + 1, 6, 6))
    J = np.stack([
        0.5 * v.factor * (predict_motion(v.raised, history, parts) - predict_motion(v.lowered, history, parts))
        for v in varied.variations
    ])  # fmt: skip
    return np.asarray(np.einsum("nti,nm,mtj->tij", J, varied.correlation, J))


def _sum_of_squares(columns: list[Floats], rows: int) -> Floats:
    """Covariance (rows, 6, 6) of a motion of which each of `columns` (rows, 6) is an independent error."""
    J = np.stack(columns) if columns else np.zeros((0, rows, 6))
    return np.asarray(np.einsum("mti,mtj->tij", J, J))

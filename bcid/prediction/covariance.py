"""The covariance of a prediction, by linearisation about it.

A predicted motion y (pose and twist at all times) depends on the state s that it starts from, on the model's constants
c, and on what the model lacks, which pushes the motion at each step (`bcid.evaluation.process_noise`):

    P(t) = J_s P_s J_s^T + J_c P_c J_c^T + J_w P_w J_w^T.

Each column of the J times its standard deviation is found by predicting twice, with the number raised and lowered by
one standard deviation, and halving the difference.  So errors add up linearly, as they do while they are small beside
the motion itself; the test beside this module draws them at random instead, and finds the same covariance.

A push lasts m periods and is correlated with the next one (AR(1), coefficient a): w_k = a w_(k-1) + sqrt(1 - a^2) xi_k.
With G_k what push k does to the motion, xi_j does sqrt(1 - a^2) H_j, H_j = G_j + a H_(j+1), and the sum over all j of
H_j H_j^T is found from the last push to the first.
"""

from __future__ import annotations

import math

import numpy as np

from bcid.aliases import Floats
from bcid.evaluation.closed_loop import integrate_poses
from bcid.evaluation.process_noise import ProcessNoise
from bcid.models.interface import History, Model
from bcid.prediction.constants import VariedConstants
from bcid.prediction.limits import LIMITS
from bcid.prediction.start import InitialState


def predict_motion(model: Model, history: History, parts: Floats) -> Floats:
    """Motion (N + 1, 6), pose [x, y, yaw] and twist [v_x, v_y, yaw rate], from the last row of a history on.

    Commands are `parts` (N, W, 4).  Rows from which on a rollout diverges may be of any size, or not finite.
    """
    twist = np.vstack([history.twist[-1], model.scan(model.init(history), parts)[1]])
    return _join_motion(history.pose[-1], twist, model.period_s)


def start_covariance(model: Model, start: InitialState, parts: Floats) -> Floats:
    """Covariance (N + 1, 6, 6) that errors of the start make in the motion under commands `parts` (N, W, 4)."""
    columns = [
        0.5 * (predict_motion(model, start.shifted(e), parts) - predict_motion(model, start.shifted(-e), parts))
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


def noise_covariance(model: Model, history: History, parts: Floats, noise: ProcessNoise) -> Floats:
    """Covariance (N + 1, 6, 6) that the model's process noise makes in the motion under commands `parts` (N, W, 4).

    Pushes come once a period, or once in several periods where there would be more than LIMITS.max_pushes of them.
    """
    every = math.ceil(len(parts) / LIMITS.max_pushes)
    h = every * model.period_s
    a = math.exp(-h / noise.tau_s) if noise.tau_s > 0.0 else 0.0
    push = h * np.array(noise.q) * math.sqrt((1.0 - a) / ((1.0 + a) * h))
    motion = predict_motion(model, history, parts)
    carries, carry = list[Floats](), model.init(history)
    begins = range(0, len(parts), every)
    for k in begins:
        carries.append(carry)
        carry = model.scan(carry, parts[k : k + every])[0]
    H = np.zeros((len(motion), 6, 3))
    covariance = np.zeros((len(motion), 6, 6))
    for k, carry in zip(reversed(begins), reversed(carries), strict=True):
        H = a * H
        H[k + 1 :] += _push_responses(model, carry, motion[k], parts[k:], push)
        share = 1.0 - a * a if k > 0 else 1.0
        covariance += share * np.einsum("tij,tkj->tik", H, H)
    return covariance


def _push_responses(model: Model, carry: Floats, motion: Floats, parts: Floats, push: Floats) -> Floats:
    """Changes (n, 6, 3) of the motion after each of n commands `parts` (n, W, 4) by pushes of each motion component.

    The pushes (3,) act on the model's state `carry`, at which pose and twist are `motion` (6,), before the first step.
    """
    signed = np.vstack([np.diag(push), -np.diag(push)])
    pushed = np.tile(carry, (6, 1))
    pushed[:, model.motion] += signed
    twist = model.scan_many(pushed, np.repeat(parts[None], 6, axis=0))[1]
    whole = np.concatenate([np.tile(motion[3:], (6, 1, 1)), twist], axis=1)
    moved = _join_motion(np.tile(motion[:3], (6, 1)), whole, model.period_s)[:, 1:]
    return np.moveaxis(0.5 * (moved[:3] - moved[3:]), 0, -1)


def _join_motion(pose: Floats, twist: Floats, period_s: float) -> Floats:
    """Motion (..., N, 6) of twists (..., N, 3) that begins with a pose (..., 3)."""
    return np.concatenate([integrate_poses(pose, twist, period_s), twist], axis=-1)


def _sum_of_squares(columns: list[Floats], rows: int) -> Floats:
    """Covariance (rows, 6, 6) of a motion of which each of `columns` (rows, 6) is an independent error."""
    J = np.stack(columns) if columns else np.zeros((0, rows, 6))
    return np.asarray(np.einsum("mti,mtj->tij", J, J))

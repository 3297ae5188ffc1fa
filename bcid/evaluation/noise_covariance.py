"""The covariance that process noise makes in a predicted pose and twist, by linearisation, and how often it holds.

A push lasts m periods and is correlated with the next one (AR(1), coefficient a): w_k = a w_(k-1) + sqrt(1 - a^2) xi_k.
With G_k what push k does to the motion, xi_j does sqrt(1 - a^2) H_j, H_j = G_j + a H_(j+1), and the sum over all j of
H_j H_j^T is found from the last push to the first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import integrate_poses
from bcid.evaluation.limits import LIMITS
from bcid.evaluation.process_noise import MIN_VARIANCE, ProcessNoise, choose_calibration_starts
from bcid.models.interface import History, Model, history_at

NORMAL_FACTOR = 1.959964
"""Standard deviations that hold 95 % of a normal law."""


def predict_motion(model: Model, history: History, parts: Floats) -> Floats:
    """Motion (N + 1, 6), pose [x, y, yaw] and twist [v_x, v_y, yaw rate], from the last row of a history on.

    Commands are `parts` (N, W, 4).  Rows from which on a rollout diverges may be of any size, or not finite.
    """
    twist = np.vstack([history.twist[-1], model.scan(model.init(history), parts)[1]])
    return _join_motion(history.pose[-1], twist, model.period_s)


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
    for k, before in zip(reversed(begins), reversed(carries), strict=True):
        H = a * H
        H[k + 1 :] += _push_responses(model, before, motion[k], parts[k:], push)
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


def calibrate_pose_factor(model: Model, estimates: Sequence[Estimate], noise: ProcessNoise) -> float | None:
    """How many standard deviations of a predicted pose, by its process noise, hold 95 % of the pose's errors.

    Process noise is fitted to errors of the twist.  The pose adds these up, and where the model is wrong in the same
    way for long, its errors grow faster than those of a random walk; where the twist's errors are hardly more than its
    measurement, it is the pose that shows what is left.  With P the variance by process noise and R that of both
    measured poses, an error e lies in the interval of the factor f if e^2 <= f^2 P + 1.96^2 R.  The starts and times
    are those from which the noise was calibrated.  None where there is no start, or a prediction is not finite.
    """
    starts, at = choose_calibration_starts(model, estimates)
    factors = list[Floats]()
    for e, k in starts:
        history, parts = history_at(e, k, model.lags), e.parts[k : k + int(at[-1])]
        error = predict_motion(model, history, parts)[at, :3] - e.pose[k + at]
        known = e.tuning.noise if e.tuning else None
        R = 2.0 * np.square([known.r_position, known.r_position, known.r_yaw]) if known else np.zeros(3)
        P = np.diagonal(noise_covariance(model, history, parts, noise), axis1=1, axis2=2)[at, :3]
        factors.append(np.sqrt(np.maximum(error**2 - NORMAL_FACTOR**2 * R, 0.0) / (P + MIN_VARIANCE)))
    factor = float(np.quantile(np.concatenate(factors), LIMITS.interval_level)) if factors else math.nan
    return factor if math.isfinite(factor) else None

"""Where the mismatch enters, before any hypothesis: what free functions would explain, channel by channel.

At every place where physics may be missing - along the wheels, across the tyres, about the yaw axis, at the
steering, at the motor, in the seen pose, between the clocks - a few plain functions of the state act with free
amplitudes.  The place whose functions explain most of the residuals, the base parameters projected out, is where
the mismatch enters.  A steered front wheel pushes along the body, across it and about it at once, so the direction
of a push in the body's frame does not tell; whether pushes lie in a wheel's, whatever they depend on, is asked beside
it (`directions`).
"""

from __future__ import annotations

import math

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.locate.basis_functions import NUDGE, SIZES, pushed_by
from bcid.diagnosis.locate.scan_statistic import Circle
from bcid.likelihood.hypothesis import Setting
from bcid.likelihood.lane_rollout import Layout, layout
from bcid.likelihood.predict import predict
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import explained, projected
from bcid.likelihood.take import Take

SERVO_RATE = 0.2  # rad/s above which the servo moves
SHIFT_S = 1e-3
NOWHERE = Circle(0.0, 0.0, 0.0, 0.0)


def explained_by(fit: Fit, take: Take, circle: Circle | None) -> dict[str, float]:
    """What each channel's functions would gain together (nats of BIC), most first; `circle` stands out."""
    columns, of = changes_by(fit, take, circle or NOWHERE)
    found = projected(fit, take, columns / np.maximum(np.sqrt((columns**2).mean(axis=(0, 1))), 1e-12))
    gains = {
        channel: explained(found, own) - 0.5 * (own.stop - own.start) * math.log(take.segments)
        for channel, own in of.items()
    }
    return dict(sorted(gains.items(), key=lambda item: -item[1]))


def changes_by(fit: Fit, take: Take, circle: Circle) -> tuple[Floats, dict[str, slice]]:
    """What every function changes in the predicted poses (N, 3, n), and each channel's columns."""
    setting, where = fit.hypothesis.setting(fit.phi, take), layout(take)
    still = np.asarray(predict(where, fit.start, *setting.acting))
    pushed = pushed_by(where, fit.start, *setting.acting, circle, sum(SIZES.values()))
    parts = {  # moves of the servo are behind the pushes of the steering, which come last
        "steering": _of_the_servo(fit, where, setting, still),
        "pose": _of_the_pose(still),
        "time": _of_the_clocks(fit, take, setting, still),
    }
    of, at = dict[str, slice](), 0
    for channel in dict.fromkeys([*SIZES, *parts]):
        size = SIZES.get(channel, 0) + (parts[channel].shape[2] if channel in parts else 0)
        of[channel] = slice(at, at + size)
        at += size
    columns = np.concatenate([pushed, *parts.values()], axis=2)
    columns[:, :, ~np.isfinite(columns).all(axis=(0, 1))] = 0.0
    return columns, of


def _of_the_servo(fit: Fit, of: Layout, setting: Setting, still: Floats) -> Floats:
    """Changes of the angle that the commands alone determine (N, 3, 7)."""
    chain = setting.chain
    d, rate = chain.delta, np.gradient(chain.delta, 0.5 * chain.h)
    functions = (np.ones_like(d), d, np.abs(d), d**3, rate, np.tanh(rate / SERVO_RATE), np.abs(rate))

    def seen(angle: Floats) -> Floats:
        return np.asarray(predict(of, fit.start, *setting._replace(chain=chain._replace(delta=angle)).acting))

    return np.stack([(seen(d + NUDGE * phi) - still) / NUDGE for phi in functions], axis=2)


def _of_the_pose(p: Floats) -> Floats:
    """Another tracked point, a turned body, a longer metre, of predicted poses p (N, 3, 4)."""
    cos_t, sin_t, none, one = np.cos(p[:, 2]), np.sin(p[:, 2]), np.zeros(len(p)), np.ones(len(p))
    rows = ((cos_t, sin_t, none), (-sin_t, cos_t, none), (none, none, one), (p[:, 0], p[:, 1], none))
    return np.stack([np.column_stack(r) for r in rows], axis=2)


def _of_the_clocks(fit: Fit, take: Take, setting: Setting, still: Floats) -> Floats:
    """A shift of the poses against the commands, constant and growing (N, 3, 2)."""
    later = layout(take)._replace(stamps=take.stamp_s + SHIFT_S)
    velocity = (np.asarray(predict(later, fit.start, *setting.acting)) - still) / SHIFT_S
    zero = np.repeat(take.zero_s, np.diff(take.first))
    time = (np.bincount(take.row, take.share * take.stamp_s) - zero)[:, None]
    return np.stack([velocity, velocity * time / take.T], axis=2)

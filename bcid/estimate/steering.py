"""Time constant and rate limit of the steering, identified where the vehicle file omits them.

The front wheel's heading is beta_f = delta + alpha_f, and alpha_f is to first order proportional to
the centripetal acceleration v_f w; so beta_f is fitted by a + g delta(T_s, d) + k v_f w.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bcid.compiled import njit
from bcid.estimate.types import Floats
from bcid.physics.steering import steering_rate

T_S_RANGE = (0.005, 1.5)
RATE_RANGE = (0.1, 60.0)
MIN_SPEED_MPS = 0.2


class Wheel(NamedTuple):
    """What one take shows of the front wheel, event by event."""

    time_s: Floats
    u_s: Floats
    beta_f: Floats
    v_f: Floats
    yaw_rate: Floats


@njit
def angle(time_s: Floats, u_s: Floats, T_s: float, d: float) -> Floats:
    """Delta (rad) at `time_s` under commands held from event to event, by midpoint steps."""
    delta = np.empty(len(time_s))
    delta[0] = u_s[0]
    for k in range(1, len(time_s)):
        steps = max(1, int(4.0 * (time_s[k] - time_s[k - 1]) / T_s))
        h = (time_s[k] - time_s[k - 1]) / steps
        value = delta[k - 1]
        for _ in range(steps):
            half = value + 0.5 * h * steering_rate(u_s[k - 1], value, T_s, d)
            value += h * steering_rate(u_s[k - 1], half, T_s, d)
        delta[k] = value
    return delta


def identify(takes: Sequence[Wheel], T_s: float | None, d: float | None) -> tuple[float, float, dict[str, Any]]:
    """T_s (s), d (rad/s) and what is to be said of them; what is given stays."""
    from scipy.optimize import least_squares

    free = [given is None for given in (T_s, d)]
    start = np.log([T_s or 0.15, d or 3.0])
    low, high = np.log([T_S_RANGE, RATE_RANGE]).T[:, free]

    def constants(x: Floats) -> tuple[float, float]:
        full = start.copy()
        full[free] = x
        return float(np.exp(full[0])), float(np.exp(full[1]))

    def residuals(x: Floats) -> Floats:
        return np.concatenate([_unexplained(take, *constants(x)) for take in takes])

    fits = [
        least_squares(
            residuals, x_0[free], bounds=(low, high), loss="soft_l1", f_scale=0.05, diff_step=[1e-3] * sum(free)
        )
        for x_0 in (start, start + np.log([0.4, 0.5]), start + np.log([2.0, 3.0]))
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    T_s_hat, d_hat = constants(best.x)
    at_bound = bool(np.any(np.isclose(best.x, low, atol=1e-2) | np.isclose(best.x, high, atol=1e-2)))
    facts = {"identified": [n for n, f in zip(("time_constant_s", "max_rate_radps"), free, strict=True) if f]}
    return T_s_hat, d_hat, {**facts, "at_bound": at_bound, "rate_reached": _rate_reached(takes, T_s_hat, d_hat)}


def _unexplained(take: Wheel, T_s: float, d: float) -> Floats:
    use = take.v_f > MIN_SPEED_MPS
    delta = angle(take.time_s, take.u_s, T_s, d)[use]
    regressors = np.column_stack([np.ones(len(delta)), delta, take.v_f[use] * take.yaw_rate[use]])
    weights, *_ = np.linalg.lstsq(regressors, take.beta_f[use], rcond=None)
    return np.asarray(take.beta_f[use] - regressors @ weights)


def _rate_reached(takes: Sequence[Wheel], T_s: float, d: float) -> bool:
    """Whether the commands ever drive the steering at its rate limit; otherwise d is not identified."""
    return any(bool(np.any(np.abs(t.u_s - angle(t.time_s, t.u_s, T_s, d)) > d * T_s)) for t in takes)

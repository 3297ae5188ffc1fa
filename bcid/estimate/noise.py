"""Process and measurement noise: given in the pipeline file, or found where the innovations are likeliest.

The paper states none of Q, R, P_0 (errata 18).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace

import numpy as np

from bcid.estimate.kernel import Events, run_filter
from bcid.estimate.process import BETAF, BETAR, DELTA, N_STATE, VF, Chassis, Floats

EXCERPT_S = 40.0
MAX_EXCERPTS = 2


@dataclass(frozen=True)
class Noise:
    """Square roots of the spectral densities (per root second) and standard deviations of the sensors."""

    q_v_f: float = 1.0  # m/s per sqrt(s)
    q_beta_f: float = 1.0  # rad per sqrt(s)
    q_beta_r: float = 0.2  # rad per sqrt(s)
    q_delta: float = 0.01  # rad per sqrt(s); keeps the smoother's covariances regular
    r_position: float = 1e-3  # m
    r_yaw: float = 2e-3  # rad
    r_steering: float = 0.01  # rad, where a measured angle is there
    r_yaw_rate: float = 0.02  # rad/s, gyro
    r_wheel_speed: float = 0.05  # m/s

    def Q(self) -> Floats:
        """Spectral density matrix (7, 7)."""
        diagonal = np.zeros(N_STATE)
        diagonal[[VF, BETAF, BETAR, DELTA]] = self.q_v_f, self.q_beta_f, self.q_beta_r, self.q_delta
        return np.diag(diagonal**2)

    def R(self) -> Floats:
        """Variances (6,) in the order of `process.MEASURED`."""
        p = self.r_position
        return np.array([p, p, self.r_yaw, self.r_steering, self.r_yaw_rate, self.r_wheel_speed]) ** 2


def excerpt(events: Events, length_s: float = EXCERPT_S) -> Events:
    """The first `length_s` of the events."""
    stop = int(np.searchsorted(events.time_s, events.time_s[0] + length_s, side="right"))
    return Events(
        events.time_s[:stop], events.u_s[:stop], events.z[:stop], events.restart[:stop], events.x_0[:stop], events.P_0
    )


def identify(takes: Sequence[Events], chassis: Chassis, start: Noise, given: Sequence[str]) -> Noise:
    """The noise under which the innovations of excerpts of `takes` are likeliest.

    Names in `given` stay as in `start`, and so do those of sensors that are not there.
    """
    from scipy.optimize import minimize

    cut = [excerpt(events) for events in takes[:MAX_EXCERPTS]]
    there = np.isfinite(np.concatenate([events.z for events in cut])).any(axis=0)
    sensor = {"r_steering": 3, "r_yaw_rate": 4, "r_wheel_speed": 5}
    free = [
        f.name for f in fields(Noise)
        if f.name not in (*given, "q_delta") and (f.name not in sensor or there[sensor[f.name]])
    ]  # fmt: skip
    if not free:
        return start
    x_0 = np.log([getattr(start, name) for name in free])

    def noise_at(x: Floats) -> Noise:
        return replace(start, **dict(zip(free, np.exp(np.clip(x, x_0 - 7, x_0 + 7)).tolist(), strict=True)))

    def cost(x: Floats) -> float:
        noise = noise_at(x)
        Q, R = noise.Q(), noise.R()
        total = -sum(run_filter(events, chassis, Q, R).log_likelihood for events in cut)
        return total if np.isfinite(total) else 1e12

    best = minimize(cost, x_0, method="Powell", options={"xtol": 0.02, "ftol": 1e-7, "maxfev": 400})
    return noise_at(np.asarray(best.x))


def as_facts(noise: Noise) -> dict[str, float]:
    """For JSON."""
    return asdict(noise)

"""Process and measurement noise: given in the pipeline file, or found where the innovations are likeliest.

The paper states none of Q, R, P_0 (errata 18).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.kernel import Events, run_filter
from bcid.estimate.process import BETAF, BETAR, DELTA, N_STATE, VF, Chassis

EXCERPT_S = 40.0
MAX_EXCERPTS = 2
PRIOR = 1.5  # weak, natural logarithm: what the takes do not show stays where it started
SEARCH = 7.0  # half width of the search, natural logarithm
FLOOR = 1e-5  # no sensor here is better (m, rad), and no process smoother


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


def livelier(takes: Sequence[Events]) -> list[Events]:
    """Excerpts of EXCERPT_S in which the car travels furthest: the best of each take, then the best of these.

    Noise found on a car at rest would fit no other.
    """
    found: list[tuple[float, Events]] = []
    for events in takes:
        seen = np.flatnonzero(np.isfinite(events.z[:, 0]))
        step = np.hypot(*np.diff(events.z[seen, :2], axis=0).T)
        step[events.restart[seen[1:]] > 0.0] = 0.0
        travelled = np.r_[0.0, np.cumsum(step)]
        time_s = events.time_s[seen]
        stop = np.minimum(np.searchsorted(time_s, time_s + EXCERPT_S), len(seen) - 1)
        begin = int(np.argmax(travelled[stop] - travelled))
        a, b = int(seen[begin]), int(seen[stop[begin]]) + 1
        found.append((float(travelled[stop[begin]] - travelled[begin]), _cut(events, a, b)))
    return [events for _, events in sorted(found, key=lambda f: -f[0])[:MAX_EXCERPTS]]


def _cut(events: Events, a: int, b: int) -> Events:
    """Events a to b; the first one is a restart at its measured pose, with the velocity found soon."""
    restart, x_0 = events.restart[a:b].copy(), events.x_0[a:b].copy()
    if restart[0] == 0.0:
        restart[0] = 1.0
        x_0[0] = 0.0
        x_0[0, :3] = events.z[a, :3]
        later = min(b, a + int(np.searchsorted(events.time_s[a:b], events.time_s[a] + 0.2)) + 1)
        moved = events.z[a:later][np.isfinite(events.z[a:later, 0])]
        x_0[0, VF] = float(np.hypot(*(moved[-1, :2] - moved[0, :2]))) / 0.2
        course = float(np.arctan2(*(moved[-1, :2] - moved[0, :2])[::-1]))
        x_0[0, BETAF] = float(np.angle(np.exp(1j * (course - events.z[a, 2]))))
        x_0[0, DELTA] = events.u_s[a]
    return Events(events.time_s[a:b], events.u_s[a:b], events.z[a:b], restart, x_0, events.P_0)


def identify(takes: Sequence[Events], chassis: Chassis, start: Noise, given: Sequence[str]) -> tuple[Noise, list[str]]:
    """The noise under which the innovations of excerpts of `takes` are likeliest, and which stopped at a bound.

    Names in `given` stay as in `start`, and so do those of sensors that are not there.
    """
    from scipy.optimize import minimize

    cut = livelier(takes)
    there = np.isfinite(np.concatenate([events.z for events in cut])).any(axis=0)
    sensor = {"r_steering": 3, "r_yaw_rate": 4, "r_wheel_speed": 5}
    free = [
        f.name for f in fields(Noise)
        if f.name not in (*given, "q_delta") and (f.name not in sensor or there[sensor[f.name]])
    ]  # fmt: skip
    if not free:
        return start, []
    x_0 = np.log([getattr(start, name) for name in free])
    low = np.maximum(x_0 - SEARCH, np.log(FLOOR))

    def noise_at(x: Floats) -> Noise:
        return replace(start, **dict(zip(free, np.exp(np.clip(x, low, x_0 + SEARCH)).tolist(), strict=True)))

    def cost(x: Floats) -> float:
        noise = noise_at(x)
        Q, R = noise.Q(), noise.R()
        total = -sum(run_filter(events, chassis, Q, R).log_likelihood for events in cut)
        total += 0.5 * float(np.sum(((x - x_0) / PRIOR) ** 2))
        return total if np.isfinite(total) else 1e12

    best = minimize(cost, x_0, method="Powell", options={"xtol": 0.02, "ftol": 1e-7, "maxfev": 400})
    edge = [n for n, x, a, b in zip(free, best.x, low, x_0 + SEARCH, strict=True) if not a + 0.05 < x < b - 0.05]
    return noise_at(np.asarray(best.x)), edge


def as_facts(noise: Noise) -> dict[str, float]:
    """For JSON."""
    return asdict(noise)

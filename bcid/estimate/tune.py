"""The estimator's constants from recordings: the steering's first, then the noise of greatest likelihood under them."""

from collections.abc import Mapping, Sequence

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.events import build_chassis, build_timeline
from bcid.estimate.kernel import Events, run_filter
from bcid.estimate.limits import LIMITS
from bcid.estimate.process import BETAF, DELTA, VF, Chassis
from bcid.estimate.steering import identify_steering
from bcid.estimate.tuning import Noise, Tuning
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

# The likelihood is evaluated on excerpts of EXCERPT_S (s), MAX_EXCERPTS at most; the poses of their first
# FIRST_COURSE_S (s) give the initial speed and course.
EXCERPT_S, MAX_EXCERPTS, FIRST_COURSE_S = 40.0, 2, 0.2
# Natural logarithms, about the start: the standard deviation of a weak prior, which keeps what the takes do not show
# where it started, and the half width of the search.
PRIOR_SD_LN, SEARCH_HALF_WIDTH_LN = 1.5, 7.0
# No sensor here is better (m, rad), and no process smoother.
SMALLEST_NOISE = 1e-5


def select_liveliest_excerpts(takes: Sequence[Events]) -> list[Events]:
    """Excerpts of EXCERPT_S seconds: the part of each take in which the car travels furthest; longest distance first.

    A take is the filter's events of one recording.  At most MAX_EXCERPTS are kept.  Parts with much motion are chosen
    since noise constants identified on a car at rest would not hold while it drives.
    """
    excerpts: list[tuple[float, Events]] = []
    for events in takes:
        seen = np.flatnonzero(np.isfinite(events.z[:, 0]))
        step = np.hypot(*np.diff(events.z[seen, :2], axis=0).T)
        step[events.restart[seen[1:]] > 0.0] = 0.0
        travelled = np.r_[0.0, np.cumsum(step)]
        time_s = events.time_s[seen]
        stop = np.minimum(np.searchsorted(time_s, time_s + EXCERPT_S), len(seen) - 1)
        begin = int(np.argmax(travelled[stop] - travelled))
        a, b = int(seen[begin]), int(seen[stop[begin]]) + 1
        excerpts.append((float(travelled[stop[begin]] - travelled[begin]), _cut_excerpt(events, a, b)))
    return [events for _, events in sorted(excerpts, key=lambda f: -f[0])[:MAX_EXCERPTS]]


def _cut_excerpt(events: Events, a: int, b: int) -> Events:
    """Filter events of the rows `a` to `b` (excluded), begun anew at `a` from the pose that was measured there.

    The initial speed and course are the means over the first FIRST_COURSE_S seconds; delta is the command at `a`.
    """
    restart, x_0 = events.restart[a:b].copy(), events.x_0[a:b].copy()
    if restart[0] == 0.0:
        restart[0] = 1.0
        x_0[0] = 0.0
        x_0[0, :3] = events.z[a, :3]
        later = min(b, a + int(np.searchsorted(events.time_s[a:b], events.time_s[a] + FIRST_COURSE_S)) + 1)
        moved = events.z[a:later][np.isfinite(events.z[a:later, 0])]
        x_0[0, VF] = float(np.hypot(*(moved[-1, :2] - moved[0, :2]))) / FIRST_COURSE_S
        course = float(np.arctan2(*(moved[-1, :2] - moved[0, :2])[::-1]))
        x_0[0, BETAF] = float(np.angle(np.exp(1j * (course - events.z[a, 2]))))
        x_0[0, DELTA] = events.u_s[a]
    return Events(events.time_s[a:b], events.u_s[a:b], events.z[a:b], restart, x_0, events.P_0)


def identify_noise(
    takes: Sequence[Events], chassis: Chassis, start: Noise, fixed: Sequence[str]
) -> tuple[Noise, list[str]]:
    """Maximum a posteriori (MAP) estimate of the EKF's noise constants, and the names of those that end at a bound.

    The filter's log-likelihood is summed over the excerpts of `takes` (each the filter events of one recording) in
    which the car travels furthest; a weak normal prior (PRIOR_SD_LN) on the logarithms is centred on `start`.  Fields
    named in `fixed`, q_delta, and those of sensors that the takes lack keep their values in `start`.
    """
    from scipy.optimize import minimize

    excerpts = select_liveliest_excerpts(takes)
    measured = np.isfinite(np.concatenate([events.z for events in excerpts])).any(axis=0)
    sensor = {"r_steering": 3, "r_yaw_rate": 4, "r_wheel_speed": 5}
    free = [
        name for name in Noise.model_fields
        if name not in (*fixed, "q_delta") and (name not in sensor or measured[sensor[name]])
    ]  # fmt: skip
    if not free:
        return start, []
    x_0 = np.log([getattr(start, name) for name in free])
    low, high = np.maximum(x_0 - SEARCH_HALF_WIDTH_LN, np.log(SMALLEST_NOISE)), x_0 + SEARCH_HALF_WIDTH_LN

    def noise_at(x: Floats) -> Noise:
        return start.model_copy(update=dict(zip(free, np.exp(np.clip(x, low, high)).tolist(), strict=True)))

    def cost(x: Floats) -> float:
        noise = noise_at(x)
        Q, R = noise.Q(), noise.R()
        total = -sum(run_filter(events, chassis, Q, R).log_likelihood for events in excerpts)
        total += 0.5 * float(np.sum(((x - x_0) / PRIOR_SD_LN) ** 2))
        return total if np.isfinite(total) else 1e12

    best = minimize(cost, x_0, method="Powell", options={"xtol": 0.02, "ftol": 1e-7, "maxfev": 400})
    margin = LIMITS.noise_bound_ln
    at_bound = [n for n, x, a, b in zip(free, best.x, low, high, strict=True) if not a + margin < x < b - margin]
    return noise_at(np.asarray(best.x)), at_bound


def tune_estimator(
    recordings: Sequence[Recording],
    vehicle: Vehicle,
    period_s: float,
    max_gap_s: float,
    fixed_noise: Mapping[str, float],
) -> Tuning:
    """Identify the EKF's constants from recordings: first the steering's that the vehicle file omits, then the noise.

    The noise is the maximum a posteriori estimate of `identify_noise`; `fixed_noise` holds fields of `Noise` that
    keep the values given.  The output grid has the period `period_s` (s) and ends segments at pose gaps over
    `max_gap_s` (s).
    """
    T_s, d, origin = identify_steering(recordings, vehicle)
    start, chassis = Noise(**fixed_noise), build_chassis(vehicle, T_s, d)
    events = [build_timeline(r, vehicle, period_s, max_gap_s, T_s, d).events for r in recordings]
    noise, at_bound = identify_noise(events, chassis, start, list(fixed_noise))
    return Tuning(noise=noise, T_s=T_s, d=d, steering=origin, noise_at_bound=tuple(at_bound))

"""Process noise that explains a model's prediction errors.

What a model lacks pushes its motion state (the first of the carry that move, `Model.motion`) at every step.  The pushes
of a component have a spectral density q^2 and are correlated over a time tau:

    push_k = h sigma z_k,   z_{k+1} = a z_k + sqrt(1 - a^2) xi_k,   a = exp(-h/tau),   sigma^2 = q^2 (1 - a)/((1 + a) h)

so that over times far beyond tau a push's integral has the variance q^2 t, whatever tau is.  Small pushes add up
linearly: the variance of a prediction is the sum over the components of q^2 times what pushes of unit density make.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats, Ints
from bcid.estimate.command_parts import stack_parts
from bcid.estimate.types import Estimate
from bcid.evaluation.limits import LIMITS
from bcid.models.fitting.windows import split_off_ends
from bcid.models.interface import Model, history_at

# Times (s) after a start at which prediction errors are taken, and values of tau (s) that are tried.
CALIBRATION_TIMES_S, CORRELATION_TIMES_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0), (0.0, 1.0, 4.0)
# Starts that the end of each take is long enough for, the most starts of all takes, and pushed rollouts from each.
STARTS_PER_TAKE, MAX_STARTS, SAMPLES = 8, 24, 16
# Pushes per root second that still add up linearly, as a share of the spread of the motion state.
PROBE_SHARE = 0.02
# Added to every variance, so that a model without errors has a likelihood.
MIN_VARIANCE = 1e-12

# A take and the row at which a prediction starts.
PredictionStart = tuple[Estimate, int]


class ProcessNoise(NamedTuple):
    """Pushes that explain a model's prediction errors, and the factor on their standard deviation that covers 95 %."""

    q: tuple[float, float, float]  # unit of the component per root second
    tau_s: float
    factor: float  # 1.96 where misses are normal
    pose_factor: float | None = None  # of the pose, which adds up the twist's errors; None where it is not known


class _PredictionErrors(NamedTuple):
    """Errors of predictions from W starts at K times after each, and how process noise of J components widens them."""

    error: Floats  # (W, K, 3)
    measured_variance: Floats  # (W, K, 3) variance of what is compared with
    gain: Floats  # (J, W, K, 3) variance per q^2 of each of J components


def draw_pushes(count: int, steps: int, q: Floats, tau: float, h: float, rng: np.random.Generator) -> Iterator[Floats]:
    """Yield autoregressive AR(1) noise (count, 3) to add to `count` motion states before each of `steps` steps.

    The three components are those of a model's motion (a twist, or v_f, alpha_f, alpha_r); steps last `h` seconds.
    `q` (3,) is the root spectral density, in the component's unit per root second, and `tau` (s) the correlation
    time.
    """
    a = math.exp(-h / tau) if tau > 0.0 else 0.0
    sigma = np.asarray(q) * math.sqrt((1.0 - a) / ((1.0 + a) * h))
    z = rng.standard_normal((count, 3))
    for _ in range(steps):
        yield h * sigma * z
        z = a * z + math.sqrt(1.0 - a * a) * rng.standard_normal((count, 3))


def sample_rollouts(
    model: Model, carries: Floats, commands: Floats, samples: int, q: Floats, tau: float, rng: np.random.Generator
) -> Floats:
    """Twists (B, S, N, 3) of S = `samples` rollouts, disturbed by random process noise, from each of B starts.

    `carries` (B, n) are the model's states at the starts, `commands` (B, N, 2) or parts (B, N, W, 4); the noise has the
    root spectral density `q` (3,), in the motion component's unit per root second, and the correlation time `tau` (s).
    """
    now, commands = np.repeat(carries, samples, axis=0), np.repeat(commands, samples, axis=0)
    out = np.empty((*commands.shape[:2], 3))
    for k, push in enumerate(draw_pushes(len(now), commands.shape[1], q, tau, model.period_s, rng)):
        now[:, model.motion] += push
        now, twists = model.scan_many(now, commands[:, k : k + 1])
        out[:, k] = twists[:, 0]
    return out.reshape(len(carries), samples, *out.shape[1:])


def list_prediction_starts(
    estimates: Sequence[Estimate], steps: int, every: int, lags: int = 0
) -> list[PredictionStart]:
    """Pairs (estimate, row): every `every`-th row with `steps` rows after it and `lags` before it in its segment."""
    return [(e, k) for e in estimates for s in e.segments() for k in range(s.start + lags, s.stop - steps, every)]


def _select_moving_starts(starts: list[PredictionStart], steps: int) -> list[PredictionStart]:
    """Starts whose mean speed over the next `steps` rows exceeds `LIMITS.min_speed_share` of the fastest start's."""
    v = [float(np.abs(e.kinematic[k : k + steps + 1, 0]).mean()) for e, k in starts]
    return [start for start, speed in zip(starts, v, strict=True) if speed > LIMITS.min_speed_share * max(v)]


def choose_calibration_starts(model: Model, estimates: Sequence[Estimate]) -> tuple[list[PredictionStart], Ints]:
    """Starts, MAX_STARTS at most, whose predictions calibrate a model's noise, and the steps (K,) after which they do.

    Starts lie in the ends of the takes, where the car moves; the steps are those of CALIBRATION_TIMES_S, as far as the
    longest segment goes, and none where it is too short.
    """
    longest = max((s.stop - s.start for e in estimates for s in e.segments()), default=0) - 1 - model.lags
    at = np.unique([max(1, round(t / model.period_s)) for t in CALIBRATION_TIMES_S])
    at = at[at <= longest]
    if len(at) == 0:
        return [], at
    steps = int(at[-1])
    _, ends = split_off_ends(estimates, STARTS_PER_TAKE * steps // 4)
    every = max(1, steps // 4)
    starts = list_prediction_starts(ends, steps, every, model.lags)
    starts = starts or list_prediction_starts(estimates, steps, every, model.lags)
    starts = _select_moving_starts(starts, steps)
    return starts[:: max(1, math.ceil(len(starts) / MAX_STARTS))], at


def calibrate_process_noise(model: Model, estimates: Sequence[Estimate], seed: int = 0) -> ProcessNoise | None:
    """Process noise fitted to a model's prediction errors: root spectral densities q (3,), correlation time, factor.

    Densities and time are the maximum-likelihood estimate, for normal errors of rollouts after each of
    CALIBRATION_TIMES_S from starts in the ends of the takes.  The factor on the standard deviation for 95 % intervals
    is an empirical quantile, since errors of an incomplete model have heavier tails than the normal law.  None where
    no segment is long enough, a rollout runs away, or the factor reaches `LIMITS.max_interval_factor`.
    """
    chosen, at = choose_calibration_starts(model, estimates)
    if len(at) == 0:
        return None
    fits = []
    for tau in CORRELATION_TIMES_S if chosen else ():
        errors = _measure_errors(model, chosen, at, tau, np.random.default_rng(seed))
        if errors is None:
            return None
        fits.append((*_fit_densities(errors), tau, errors))
    if not fits:
        return None
    _, q2, tau, errors = min(fits, key=lambda row: row[0])
    ratio = np.abs(errors.error) / np.sqrt(_error_variance(errors, q2))
    x, y, z = np.sqrt(q2).tolist()
    factor = float(np.quantile(ratio, LIMITS.interval_level))
    return ProcessNoise((x, y, z), tau, factor) if factor < LIMITS.max_interval_factor else None


def _measure_errors(
    model: Model, starts: Sequence[PredictionStart], at: npt.NDArray[np.intp], tau: float, rng: np.random.Generator
) -> _PredictionErrors | None:
    """Errors (W, K, 3) of rollouts from W starts after `at` (K,) steps, and their variance per unit of noise density.

    The variance is found by Monte Carlo, with noise of correlation time `tau` (s) on one of the model's three motion
    components at a time.  None where an error passes `LIMITS.runaway_factor` times the sum of the largest measured
    motion and its range, or where a figure is not finite.
    """
    steps = int(at[-1])
    carries = np.stack([model.init(history_at(e, k, model.lags)) for e, k in starts])
    commands = stack_parts([e.parts[k : k + steps] for e, k in starts])
    plain = model.scan_many(carries, commands)[1][:, at - 1]
    rows = [k + at for _, k in starts]
    measured = np.stack([e.twist[r] for (e, _), r in zip(starts, rows, strict=True)])
    known = np.stack([e.twist_sd[r] ** 2 for (e, _), r in zip(starts, rows, strict=True)])
    far = LIMITS.runaway_factor * (np.abs(measured).max(axis=(0, 1)) + np.ptp(measured))
    if not (np.abs(plain - measured) <= far).all():
        return None
    unit = PROBE_SHARE * np.maximum(carries[:, model.motion].std(axis=0), 1e-3)
    answer = []
    for j in range(3):
        q = np.where(np.arange(3) == j, unit, 0.0)
        many = sample_rollouts(model, carries, commands, SAMPLES, q, tau, rng)
        off = many[:, :, at - 1] - plain[:, None]
        answer.append((off**2).mean(axis=1) / unit[j] ** 2)
    return _PredictionErrors(plain - measured, known, np.array(answer)) if np.isfinite(answer).all() else None


def _error_variance(errors: _PredictionErrors, q2: Floats) -> Floats:
    """Variances (W, K, 3) of twist prediction errors of W starts after K times: process plus measurement noise.

    The process noise contributes sum_j q2_j gain_j, with `q2` (3,) its spectral densities and gain_j the variance
    that a unit density of motion component j causes.
    """
    return np.asarray(np.tensordot(q2, errors.gain, axes=1) + errors.measured_variance + MIN_VARIANCE)


def _fit_densities(errors: _PredictionErrors) -> tuple[float, Floats]:
    """Minimum of the negative log-likelihood of prediction errors, and the process noise q^2 (3,) at which it lies.

    The prediction errors are taken as normal with mean zero and the variances of `_error_variance`; constants are
    left out.
    """
    from scipy.optimize import minimize

    def cost(logs: Floats) -> tuple[float, Floats]:
        q2 = np.exp(logs)
        variance = _error_variance(errors, q2)
        slope = 0.5 * (1.0 / variance - errors.error**2 / variance**2)
        value = float(0.5 * np.sum(np.log(variance) + errors.error**2 / variance))
        return value, q2 * np.tensordot(errors.gain, slope, axes=3)

    typical = np.maximum((errors.error**2).mean(), 1e-12) / np.maximum(errors.gain.mean(axis=(1, 2, 3)), 1e-12)
    best = minimize(cost, np.log(typical / 3.0), jac=True, method="L-BFGS-B", bounds=[(-30.0, 10.0)] * 3)
    return float(best.fun), np.exp(best.x)

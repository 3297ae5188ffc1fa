"""How far a model's predictions may be off: process noise that explains its misses, and intervals made of it.

What a model lacks pushes its motion state (the first of the carry that move, `Model.motion`) at every step.  The pushes
of a component have a spectral density q^2 and are alike over a time tau:

    push_k = h sigma z_k,   z_{k+1} = a z_k + sqrt(1 - a^2) xi_k,   a = exp(-h/tau),   sigma^2 = q^2 (1 - a)/((1 + a) h)

so that over times far beyond tau a push's integral has the variance q^2 t, whatever tau is.  Small pushes add up
linearly: the variance of a prediction is a sum of what each component's pushes alone make, times its q^2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.models.fitting.windows import divided
from bcid.models.interface import History, Model, history_at

HORIZONS_S = (0.5, 2.0, 10.0)  # at which intervals are checked
CALIBRATED_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # after a start, the misses that noise is found from
TAUS_S = (0.0, 1.0, 4.0)
FAR, WILD = 10.0, 10.0  # times what was driven, a miss that is no miss any more; deviations that no law has
MOVES = 0.1  # of the fastest stretch's mean speed
WITHIN = 0.6827  # of a normal law within one deviation
FEWEST, MOST = 8, 24  # starts that noise is found from, of each take and in all
ABREAST = 50  # rollouts whose samples are drawn together
SAMPLES, MANY = 16, 200  # pushed vehicles per start: to find the noise, to draw an interval
SMALL = 0.02  # of a component's spread, the pushes per root second that still add up linearly
COVERED = 0.95


class ProcessNoise(NamedTuple):
    """Root spectral density of each component's pushes, their time, and how many deviations hold 95 %."""

    q: tuple[float, float, float]  # unit of the component per root second
    tau_s: float
    factor: float  # 1.96 where misses are normal


class Prediction(NamedTuple):
    """A rollout with its 95 % interval."""

    twist: Floats  # (N, 3) after each command
    half: Floats  # (N, 3) the interval's half width


class _Misses(NamedTuple):
    """At W starts and K times after them."""

    miss: Floats  # (W, K, 3)
    known: Floats  # (W, K, 3) variance of what is compared with
    answer: Floats  # (J, W, K, 3) variance per q^2 of each of J components


def _pushes(count: int, steps: int, q: Floats, tau: float, h: float, rng: np.random.Generator) -> Iterator[Floats]:
    """What is added to the motion state before each step (count, 3)."""
    a = math.exp(-h / tau) if tau > 0.0 else 0.0
    sigma = np.asarray(q) * math.sqrt((1.0 - a) / ((1.0 + a) * h))
    z = rng.standard_normal((count, 3))
    for _ in range(steps):
        yield h * sigma * z
        z = a * z + math.sqrt(1.0 - a * a) * rng.standard_normal((count, 3))


def pushed(
    model: Model, carries: Floats, commands: Floats, q: Floats, tau: float, rng: np.random.Generator
) -> Floats:  # fmt: skip
    """Twists (B, N, 3) of B vehicles under `commands` (B, N, 2) and random pushes."""
    now, out = np.array(carries), np.empty((*commands.shape[:2], 3))
    for k, push in enumerate(_pushes(len(now), commands.shape[1], q, tau, model.period_s, rng)):
        now[:, model.motion] += push
        now, twists = model.scan_many(now, commands[:, k : k + 1])
        out[:, k] = twists[:, 0]
    return out


def starts(estimates: Sequence[Estimate], steps: int, every: int, lags: int = 0) -> list[tuple[Estimate, int]]:
    """Rows from which `steps` follow without a break and before which `lags` lie, `every` so many."""
    return [(e, k) for e in estimates for s in e.segments() for k in range(s.start + lags, s.stop - steps, every)]


def _moving(found: list[tuple[Estimate, int]], steps: int) -> list[tuple[Estimate, int]]:
    """Those starts from which the car moves: a car at rest misses nothing."""
    v = [float(np.abs(e.kinematic[k : k + steps + 1, 0]).mean()) for e, k in found]
    return [start for start, speed in zip(found, v, strict=True) if speed > MOVES * max(v)]


def calibrated(model: Model, estimates: Sequence[Estimate], seed: int = 0) -> ProcessNoise | None:
    """The noise that makes the model's misses at the takes' ends likeliest.

    None where no stretch is long enough, or where the model runs away: no noise explains that.  The deviations that
    hold 95 % are counted, not taken from the normal law: what a model lacks comes in bouts.
    """
    longest = max((s.stop - s.start for e in estimates for s in e.segments()), default=0) - 1 - model.lags
    at = np.unique([max(1, round(t / model.period_s)) for t in CALIBRATED_S])
    at = at[at <= longest]
    if len(at) == 0:
        return None
    steps = int(at[-1])
    _, ends = divided(estimates, FEWEST * steps // 4)
    every = max(1, steps // 4)
    found = _moving(starts(ends, steps, every, model.lags) or starts(estimates, steps, every, model.lags), steps)
    held = found[:: math.ceil(len(found) / MOST)]
    tried = []
    for tau in TAUS_S if held else ():
        misses = _misses(model, held, at, tau, np.random.default_rng(seed))
        if misses is None:
            return None
        tried.append((*_likeliest(misses), tau, misses))
    if not tried:
        return None
    _, q2, tau, misses = min(tried, key=lambda found: found[0])
    ratio = np.abs(misses.miss) / np.sqrt(_variance(misses, q2))
    x, y, z = np.sqrt(q2).tolist()
    factor = float(np.quantile(ratio, COVERED))
    return ProcessNoise((x, y, z), tau, factor) if factor < WILD else None


def _misses(
    model: Model, held: Sequence[tuple[Estimate, int]], at: npt.NDArray[np.intp], tau: float, rng: np.random.Generator
) -> _Misses | None:
    """Of the rollouts from the starts `held`, `at` steps after each; None where one goes far beyond what was driven."""
    steps = int(at[-1])
    carries = np.stack([model.init(history_at(e, k, model.lags)) for e, k in held])
    commands = np.stack([e.command[k : k + steps] for e, k in held])
    plain = model.scan_many(carries, commands)[1][:, at - 1]
    rows = [k + at for _, k in held]
    measured = np.stack([e.twist[r] for (e, _), r in zip(held, rows, strict=True)])
    known = np.stack([e.twist_sd[r] ** 2 for (e, _), r in zip(held, rows, strict=True)])
    if not (np.abs(plain - measured) <= FAR * (np.abs(measured).max(axis=(0, 1)) + np.ptp(measured))).all():
        return None
    unit = SMALL * np.maximum(carries[:, model.motion].std(axis=0), 1e-3)
    answer = []
    for j in range(3):
        q = np.where(np.arange(3) == j, unit, 0.0)
        many = pushed(model, np.repeat(carries, SAMPLES, axis=0), np.repeat(commands, SAMPLES, axis=0), q, tau, rng)
        off = many.reshape(len(held), SAMPLES, steps, 3)[:, :, at - 1] - plain[:, None]
        answer.append((off**2).mean(axis=1) / unit[j] ** 2)
    return _Misses(plain - measured, known, np.array(answer)) if np.isfinite(answer).all() else None


def _variance(of: _Misses, q2: Floats) -> Floats:
    return np.asarray(np.tensordot(q2, of.answer, axes=1) + of.known + 1e-12)


def _likeliest(of: _Misses) -> tuple[float, Floats]:
    """Minus the normal log-likelihood, and the q^2 (3,) where it is least."""
    from scipy.optimize import minimize

    def cost(logs: Floats) -> tuple[float, Floats]:
        q2 = np.exp(logs)
        variance = _variance(of, q2)
        slope = 0.5 * (1.0 / variance - of.miss**2 / variance**2)
        return (
            float(0.5 * np.sum(np.log(variance) + of.miss**2 / variance)),
            q2 * np.tensordot(of.answer, slope, axes=3),
        )

    typical = np.maximum((of.miss**2).mean(), 1e-12) / np.maximum(of.answer.mean(axis=(1, 2, 3)), 1e-12)
    found = minimize(cost, np.log(typical / 3.0), jac=True, method="L-BFGS-B", bounds=[(-30.0, 10.0)] * 3)
    return float(found.fun), np.exp(found.x)


def predicted(
    model: Model, history: History, commands: Floats, noise: ProcessNoise, samples: int = MANY, seed: int = 0
) -> Prediction:
    """The rollout under `commands` (N, 2) and its interval, from `samples` of its noise."""
    found = _predicted(model, model.init(history)[None], commands[None], noise, samples, seed)
    return Prediction(found.twist[0], found.half[0])


def _predicted(
    model: Model, carries: Floats, commands: Floats, noise: ProcessNoise, samples: int, seed: int
) -> Prediction:
    """The same of B rollouts from `carries` (B, n) under `commands` (B, N, 2): twists and half widths (B, N, 3).

    By the share of the samples that lies within one deviation, which a few that run away do not change; where a third
    does, the interval has no end.
    """
    plain = model.scan_many(carries, commands)[1]
    many = pushed(
        model, np.repeat(carries, samples, axis=0), np.repeat(commands, samples, axis=0), np.array(noise.q),
        noise.tau_s, np.random.default_rng(seed),
    ).reshape(len(plain), samples, *plain.shape[1:])  # fmt: skip
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(many - plain[:, None])
    return Prediction(plain, noise.factor * np.quantile(np.where(np.isfinite(off), off, np.inf), WITHIN, axis=1))


def half_widths(model: Model, estimate: Estimate, noise: ProcessNoise | None) -> Floats:
    """Half widths (K, 3) of the intervals of a rollout from each segment's start; NaN without a noise."""
    half = np.full_like(estimate.twist, np.nan)
    if noise is None:
        return half
    for s in estimate.segments():
        half[s.start] = 0.0
        if s.stop - s.start > 1:
            commands, history = estimate.command[s.start : s.stop - 1], history_at(estimate, s.start, model.lags)
            half[s.start + 1 : s.stop] = predicted(model, history, commands, noise).half
    return half


def coverage(model: Model, estimate: Estimate, noise: ProcessNoise, seed: int = 0) -> list[dict[str, Any]]:
    """How often the take's twist lies within the 95 % interval at each of HORIZONS_S.

    Starts are a horizon apart, so that no two rollouts share a row; the share's own interval (Wilson's) counts each as
    one, whatever its three channels say.  The smoothed twist's own standard deviation widens the interval.
    """
    from scipy.stats import binomtest

    told = []
    for horizon in HORIZONS_S:
        n, within = round(horizon / model.period_s), list[float]()
        found = starts([estimate], n, n, model.lags) if n else []
        for some in (found[i : i + ABREAST] for i in range(0, len(found), ABREAST)):
            carries = np.stack([model.init(history_at(e, k, model.lags)) for e, k in some])
            made = _predicted(model, carries, np.stack([e.command[k : k + n] for e, k in some]), noise, MANY, seed)
            ends = np.array([k + n for _, k in some])
            half = np.hypot(made.half[:, -1], noise.factor * estimate.twist_sd[ends])
            within += (np.abs(made.twist[:, -1] - estimate.twist[ends]) <= half).mean(axis=1).tolist()
        if within:
            share = float(np.mean(within))
            low, high = binomtest(round(share * len(within)), len(within)).proportion_ci(0.95, "wilson")
            told.append({"horizon_s": horizon, "covered": share, "ci95": [low, high], "starts": len(within)})
    return told

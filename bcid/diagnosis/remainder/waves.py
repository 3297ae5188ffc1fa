"""Fine waves: periodic forces, turns of the wheel and errors of the tracking, by how much likelier each makes a take.

Smooth functions cannot follow what swings many times over the range of a quantity.  A wave cos(k . s + phi) of any
wave vector k is tried beside what smooth functions explain: with the slope e and the information H of a history of
forces, projected on the direction in which it acts, its cosine and sine gain |sum e exp(-i k . s)|^2 / (2 g) nats, g
being their information.  That is a periodogram, weighted as the likelihood is.  By chance the best of N waves gains
about log N, which is the price of each.  Pushes are not as white as the likelihood takes them to be: a wave must stand
out from the scatter of its sums over segments, too.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.functions import SEEN_SIZE, TURN_RAD, RemainderBasis
from bcid.diagnosis.remainder.information import TakeInformation
from bcid.effects.remainder_table import COLUMNS, DIRECTION, DIRECTIONS, INPUTS, PHASE, WAVE
from bcid.likelihood.force_history import HISTORY, unit_actions
from bcid.likelihood.take import KNOT_S, KNOTS, N_NUISANCE
from bcid.likelihood.tracking_functions import (
    FIRST_WAVE,
    INTO,
    SHIFT,
    TRACKING_COLUMNS,
    TRACKING_DIRECTIONS,
    TRACKING_INPUTS,
)
from bcid.physics.car import Car

CHANNEL_OF = {
    "body_x": "fx", "world_x": "fx", "world_y": "fx", "front_across": "fy", "yaw": "mz", "driven_along": "motor",
    "rolling": "fx", "wheel_angle": "steering",
}  # fmt: skip
"""Directions in which waves are sought, and their channels."""

OVER_PLACE = ("body_x", "rolling", "world_x", "world_y", "yaw")
"""Directions in which waves over the floor are sought."""

FINEST_HZ, FINEST_CYCLES_PER_M = 2.0, 1.2
SLOWEST_CYCLES = 2.0  # over a take, or over the floor: what is slower is smooth
BIN_S = 0.025
MOST_WAVES = 8
PEAKS = 6  # of a spectrum that are solved for
GRATINGS_AT_ONCE = 64  # that fit the cache


class Wave(NamedTuple):
    """A wave that makes a take likelier, as two functions, its cosine and its sine."""

    channel: str
    functions: Floats  # (2, COLUMNS) on the body, or (2, TRACKING_COLUMNS) in the tracking
    gain: float  # nats
    price: float = 0.0  # of the choice


class ForceField(NamedTuple):
    """Slope and information of what acts in one direction, at L instants of each of S segments, segments weighted."""

    slope: Floats  # (S, L)
    information: Floats  # (S, L, L), or their sum (L, L)


class Gains(NamedTuple):
    """What each of F waves would gain (nats), by the likelihood and by how much its sums over segments scatter."""

    likely: Floats  # (F,)
    scattered: Floats  # (F,)
    waves: dict[str, Floats]  # wave numbers (F,) by quantity

    @classmethod
    def of_sums(cls, whole: Floats, each: Floats, information: Floats, waves: dict[str, Floats]) -> Gains:
        """Gains of waves with squared sums `whole` (F,) over a take, and summed squares `each` (F,) of segments.

        Where the noise is not white, sums scatter more than the `information` (F,) of a wave says.
        """
        least = np.maximum(information, 1e-12)
        return cls(0.5 * whole / least, 0.5 * whole / np.maximum(0.5 * each, least), waves)


def find_wave(
    at: TakeInformation, car: Car, weights: Floats, moved: Floats, c: Floats, least: float = 0.0
) -> Wave | None:
    """The best wave beside names `moved` and the coefficients `c`, if it gains enough beyond its price.

    It must gain more than `least` nats, too.
    """
    acts = at.values @ (c - at.c)
    slope = at.carrier_slopes - np.einsum("snq,n->sq", at.cross, moved) - np.einsum("sqp,sp->sq", at.carriers, acts)
    fields = [*_gains_on_body(at, car, weights, slope), *_gains_in_tracking(at, weights, moved, acts)]
    price, best = float(np.log(sum(len(gains.likely) for _, _, gains in fields))), None
    for channel, direction, gains in fields:
        enough = np.minimum(gains.likely, gains.scattered) > price + SEARCH_LIMITS.min_wave_nats
        likely = np.where(enough, gains.likely, 0.0)
        k = int(np.argmax(likely))
        if likely[k] > max(least, best.gain if best else 0.0):
            best = Wave(channel, _wave_functions(channel, direction, gains.waves, k), float(likely[k]), price)
    return best


def _wave_functions(channel: str, direction: str, waves: dict[str, Floats], k: int) -> Floats:
    """The cosine and the sine of the wave number `k`, as rows of a table of functions."""
    if channel == "pose":
        seen = np.zeros((2, TRACKING_COLUMNS))
        seen[:, INTO], seen[1, SHIFT] = TRACKING_DIRECTIONS.index(direction), -0.5 * np.pi
        for name, numbers in waves.items():
            seen[:, FIRST_WAVE + TRACKING_INPUTS.index(name)] = numbers[k]
        return seen
    functions = np.zeros((2, COLUMNS))
    functions[:, DIRECTION], functions[1, PHASE] = DIRECTIONS.index(direction), -0.5 * np.pi
    for name, numbers in waves.items():
        functions[:, WAVE + INPUTS.index(name)] = numbers[k]
    return functions


def _gains_on_body(at: TakeInformation, car: Car, weights: Floats, slope: Floats) -> Iterator[tuple[str, str, Gains]]:
    """Channel, direction and gains of all waves over time, and over place, that act on the body."""
    s = at.along
    units = unit_actions(s, car)
    S, knots = s.shape[:2]
    e = (weights[:, None] * slope[:, :HISTORY]).reshape(S, knots, -1)
    H = (weights[:, None, None] * at.carriers[:, :HISTORY, :HISTORY]).reshape(S, knots, -1, knots, e.shape[2])
    t, place = s[:, :, INPUTS.index("t")], s[:, :, [INPUTS.index("p_x"), INPUTS.index("p_y")]]
    fields = {d: _act_in_direction(e, H, units[..., DIRECTIONS.index(d)]) for d in CHANNEL_OF}
    for direction, field in fields.items():
        spectrum = _spectrum(field.slope, field.information.sum(axis=0), t, KNOT_S * KNOTS / knots)
        yield CHANNEL_OF[direction], direction, _solve_peaks(spectrum, field, t)
    for direction, gains in zip(OVER_PLACE, _gratings([fields[d] for d in OVER_PLACE], place), strict=True):
        yield CHANNEL_OF[direction], direction, gains


def _act_in_direction(e: Floats, H: Floats, acts: Floats) -> ForceField:
    """What acts along a direction with the components `acts` (S, L, C), of the slopes (S, L, C) and information."""
    slope = np.einsum("skc,skc->sk", e, acts)
    return ForceField(slope, np.einsum("skc,skcld,sld->skl", acts, H, acts, optimize=True))


def _spectrum(slope: Floats, information: Floats, t: Floats, step_s: float) -> Gains:
    """Gains of waves in time, by slopes (S, L) at times `t` (S, L), `step_s` apart, and their information (L, L)."""
    bins = np.round(t.ravel() / BIN_S).astype(int)
    bins -= bins.min()
    length = 1 << int(np.ceil(np.log2(2 * (bins.max() + 1))))
    sums = np.fft.rfft(np.bincount(bins, slope.ravel(), length))
    hz = np.arange(len(sums)) / (length * BIN_S)
    on = (hz >= SLOWEST_CYCLES / ((bins.max() + 1) * BIN_S)) & (hz <= FINEST_HZ)
    omega = 2.0 * np.pi * hz[on]
    turns = np.exp(-1j * step_s * np.arange(slope.shape[1])[:, None] * omega)
    each = (np.abs(slope @ turns) ** 2).sum(axis=0)
    g = 0.5 * np.einsum("kf,kf->f", turns.conj(), information @ turns).real
    return Gains.of_sums(np.abs(sums[on]) ** 2, each, g, {"t": omega})


def _solve_peaks(gains: Gains, field: ForceField, t: Floats) -> Gains:
    """The gains of waves in time with those of the largest peaks solved for cosine and sine together, all others zero.

    What the car is at follows the time, too: the information of a wave is not that of any phase.
    """
    likely = np.zeros_like(gains.likely)
    for k in np.argsort(gains.likely)[-PEAKS:]:
        angle = gains.waves["t"][k] * t
        u = np.stack([np.cos(angle), np.sin(angle)], axis=2)
        b, G = np.einsum("sk,skc->c", field.slope, u), np.einsum("skc,skd->cd", u, field.information @ u)
        likely[k] = 0.5 * float(b @ np.linalg.lstsq(G, b, rcond=1e-9)[0])
    return gains._replace(likely=likely)


def _gratings(fields: Sequence[ForceField], place: Floats) -> Iterator[Gains]:
    """Gains, for each of the `fields`, of waves over the floor, the places being `place` (S, L, 2)."""
    size = np.ptp(place.reshape(-1, 2), axis=0)
    n = np.ceil(FINEST_CYCLES_PER_M * size * 2.0).astype(int)
    half_waves = np.stack(np.meshgrid(np.arange(n[0] + 1), np.arange(-n[1], n[1] + 1), indexing="ij"), axis=-1)
    half_waves = half_waves.reshape(-1, 2)
    fine = np.hypot(*(0.5 * half_waves.T)) >= 0.5 * SLOWEST_CYCLES
    fine &= np.hypot(*(0.5 * half_waves / size).T) <= FINEST_CYCLES_PER_M
    k = np.pi * half_waves[fine] / size
    whole, each, g = (np.empty((len(fields), len(k))) for _ in range(3))
    for some in np.array_split(np.arange(len(k)), max(1, len(k) // GRATINGS_AT_ONCE)):
        angle = place @ k[some].T
        u = np.concatenate([np.cos(angle), np.sin(angle)], axis=2)
        for d, (slope, information) in enumerate(fields):
            sums = np.matmul(slope[:, None, :], u)[:, 0].reshape(len(u), 2, -1)
            whole[d, some] = (sums.sum(axis=0) ** 2).sum(axis=0)
            each[d, some] = (sums**2).sum(axis=(0, 1))
            g[d, some] = 0.5 * np.einsum("skf,skf->f", u, np.matmul(information, u)).reshape(2, -1).sum(axis=0)
    waves = {"p_x": k[:, 0], "p_y": k[:, 1]}
    return (Gains.of_sums(*sums, waves) for sums in zip(whole, each, g, strict=True))


def _gains_in_tracking(
    at: TakeInformation, weights: Floats, moved: Floats, acts: Floats
) -> Iterator[tuple[str, str, Gains]]:
    """Channel, direction and gains of all waves over time of x, y and yaw as they are seen."""
    rows, n, S, L = at.rows, len(moved), len(at.first) - 1, int(np.diff(at.first).max())
    A, J = rows[:, :, :N_NUISANCE], rows[:, :, N_NUISANCE : N_NUISANCE + n]
    carried = rows[:, :, N_NUISANCE + n : -1]
    slope, mean, t = np.zeros((S, 3, L)), np.zeros((3, L, L)), np.zeros((S, L))
    for s, (a, b) in enumerate(itertools.pairwise(at.first)):
        r = rows[a:b, :, -1] - J[a:b] @ moved - carried[a:b] @ acts[s]
        own, V, m = A[a:b], at.terms.V[s], b - a
        slope[s, :, :m] = weights[s] * (r - own @ (V @ np.einsum("ncz,nc->z", own, r))).T
        mean[:, :m, :m] += weights[s] * (np.eye(m) - np.einsum("ncz,zy,mcy->cnm", own, V, own, optimize=True))
        t[s, :m], t[s, m:] = at.seen_s[a:b], at.seen_s[b - 1]
    gap = float(np.median(np.diff(t, axis=1)))
    for c, direction in enumerate(("seen_x", "seen_y", "seen_yaw")):
        yield "pose", direction, _spectrum(slope[:, c], mean[c], t, gap)


def add_waves(basis: RemainderBasis, waves: list[Wave]) -> RemainderBasis:
    """The basis with cosines and sines of `waves` beside its functions, each channel's under a spread of its own."""
    body, tracking = [basis.functions], [basis.tracking]
    channel, size = list(basis.channel), list(basis.size)
    B, prices = len(basis.functions), dict(basis.prices)
    for wave in waves:
        group = f"{wave.channel}~"
        prices[group] = prices.get(group, 0.0) + wave.price
        per_unit = {"mz": basis.yaw_size, "steering": TURN_RAD, "pose": SEEN_SIZE}.get(wave.channel, 1.0)
        if wave.functions.shape[1] == COLUMNS:
            body.append(wave.functions)
            channel[B:B], size[B:B] = [group] * 2, [per_unit] * 2
            B += 2
        else:
            tracking.append(wave.functions)
            channel += [group] * 2
            size += [per_unit] * 2
    return basis._replace(
        functions=np.concatenate(body),
        tracking=np.concatenate(tracking),
        channel=tuple(channel),
        size=np.array(size),
        prices=prices,
    )

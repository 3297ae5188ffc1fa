"""Fine waves: periodic forces, turns of the wheel and errors of the tracking, by how much likelier each makes a take.

Smooth functions cannot follow what swings many times over the range of a quantity.  A wave cos(k . s + phi) of any
wave vector k is tried beside what smooth functions explain: with the slope e and the information H of a history of
forces, projected on the direction in which it acts, its cosine and sine gain |sum e exp(-i k . s)|^2 / (2 g) nats, g
being their information.  That is a periodogram, weighted as the likelihood is.  By chance the best of N waves gains
about log N, which is the price of each.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.remainder.information import TakeInformation
from bcid.effects.remainder import COLUMNS, DIRECTION, DIRECTIONS, INPUTS, PHASE, WAVE
from bcid.likelihood.force_history import HEADING, HISTORY, unit_actions
from bcid.likelihood.predict import FINE
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
    "wheel_angle": "steering",
}  # fmt: skip
"""Directions in which waves are sought, and their channels."""

FINEST_HZ, FINEST_CYCLES_PER_M = 2.0, 1.2
SLOWEST_CYCLES = 2.0  # over a take, or over the floor: what is slower is smooth
BIN_S = 0.025
MOST_WAVES = 8


class Wave(NamedTuple):
    """A wave that makes a take likelier, as two functions, its cosine and its sine."""

    channel: str
    functions: Floats  # (2, COLUMNS) on the body, or (2, TRACKING_COLUMNS) in the tracking
    gain: float  # nats
    price: float = 0.0  # of the choice


class Field(NamedTuple):
    """Slope and information of accelerations in one direction, in each knot of S segments."""

    slope: Floats  # (S, knots)
    information: Floats  # (S, knots, knots)


def find_wave(
    at: TakeInformation, car: Car, weights: Floats, moved: Floats, c: Floats, least: float = 0.0
) -> Wave | None:
    """The best wave beside names `moved` and the coefficients `c`, if it gains enough beyond its price.

    It must gain more than `least` nats, too.
    """
    acts = at.values @ (c - at.c)
    slope = at.carrier_slopes - np.einsum("snq,n->sq", at.cross, moved) - np.einsum("sqp,sp->sq", at.carriers, acts)
    every = [*_waves_on_body(at, car, weights, slope), *_waves_in_tracking(at, weights, moved, acts)]
    best, price = max((w for w, _ in every), key=lambda w: w.gain), float(np.log(sum(n for _, n in every)))
    enough = max(price + SEARCH_LIMITS.min_wave_nats, least)
    return best._replace(price=price) if best.gain > enough else None


def _waves_on_body(at: TakeInformation, car: Car, weights: Floats, slope: Floats) -> Iterator[tuple[Wave, int]]:
    """The best wave of each direction over time, and over place, with the number that were tried."""
    s = at.along
    units = unit_actions(s[:, :, INPUTS.index("delta")], s[:, :, HEADING], car)
    S, knots = s.shape[:2]
    e = slope[:, :HISTORY].reshape(S, knots, -1)
    H = at.carriers[:, :HISTORY, :HISTORY].reshape(S, knots, -1, knots, e.shape[2])
    t = s[:, :, INPUTS.index("t")]
    place = s[:, :, [INPUTS.index("p_x"), INPUTS.index("p_y")]]
    for direction, channel in CHANNEL_OF.items():
        acts = units[..., DIRECTIONS.index(direction)]
        field = Field(
            np.einsum("skc,skc->sk", e, acts),
            np.einsum("skc,skcld,sld->skl", acts, H, acts, optimize=True),
        )
        over = {"t": _spectrum(field, t, weights)}
        if direction in ("body_x", "world_x", "world_y", "yaw"):
            over["place"] = _gratings(field, place, weights)
        for gains, waves in over.values():
            k = int(np.argmax(gains))
            functions = np.zeros((2, COLUMNS))
            functions[:, DIRECTION], functions[1, PHASE] = DIRECTIONS.index(direction), -0.5 * np.pi
            for name, number in waves.items():
                functions[:, WAVE + INPUTS.index(name)] = number[k]
            yield Wave(channel, functions, float(gains[k])), len(gains)


def _spectrum(field: Field, t: Floats, weights: Floats) -> tuple[Floats, dict[str, Floats]]:
    """Gains (F,) of waves in time and their wave numbers (rad/s)."""
    omega, sums = _fourier((weights[:, None] * field.slope).ravel(), t.ravel())
    mean = np.tensordot(weights, field.information, axes=1)
    lag = (np.arange(len(mean))[:, None] - np.arange(len(mean))) * KNOT_S * KNOTS / FINE.knots
    g = 0.5 * np.array([np.sum(mean * np.cos(w * lag)) for w in omega])
    return 0.5 * np.abs(sums) ** 2 / np.maximum(g, 1e-12), {"t": omega}


def _fourier(values: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Angular frequencies (F,) and sums of `values` times exp(-i omega t), by bins of BIN_S."""
    bins = np.round(t / BIN_S).astype(int)
    bins -= bins.min()
    length = 1 << int(np.ceil(np.log2(2 * (bins.max() + 1))))
    sums = np.fft.rfft(np.bincount(bins, values, length))
    hz = np.arange(len(sums)) / (length * BIN_S)
    span = (bins.max() + 1) * BIN_S
    on = (hz >= SLOWEST_CYCLES / span) & (hz <= FINEST_HZ)
    return 2.0 * np.pi * hz[on], sums[on]


def _gratings(field: Field, place: Floats, weights: Floats) -> tuple[Floats, dict[str, Floats]]:
    """Gains (F,) of waves over the floor, and their wave numbers in x and y (rad/m)."""
    size = np.ptp(place.reshape(-1, 2), axis=0)
    n = np.ceil(FINEST_CYCLES_PER_M * size * 2.0).astype(int)
    a, b = np.meshgrid(np.arange(0, n[0] + 1), np.arange(-n[1], n[1] + 1), indexing="ij")
    cycles = 0.5 * np.stack([a.ravel() / size[0], b.ravel() / size[1]], axis=1)
    length = np.hypot(0.5 * a.ravel(), 0.5 * b.ravel())
    fine = (length >= SLOWEST_CYCLES * 0.5) & (np.hypot(*cycles.T) <= FINEST_CYCLES_PER_M)
    fine &= (a.ravel() > 0) | (b.ravel() > 0)
    k = 2.0 * np.pi * cycles[fine]
    gains = np.empty(len(k))
    E, H = weights[:, None] * field.slope, weights[:, None, None] * field.information
    for some in np.array_split(np.arange(len(k)), max(1, len(k) // 256)):
        angle = place @ k[some].T
        u = np.concatenate([np.cos(angle), np.sin(angle)], axis=2)
        b_both = np.einsum("sk,skf->f", E, u, optimize=True)
        g = np.einsum("skf,skf->f", u, H @ u)
        half = len(some)
        total = np.maximum(0.5 * (g[:half] + g[half:]), 1e-12)
        gains[some] = 0.5 * (b_both[:half] ** 2 + b_both[half:] ** 2) / total
    return gains, {"p_x": k[:, 0], "p_y": k[:, 1]}


def _waves_in_tracking(at: TakeInformation, weights: Floats, moved: Floats, acts: Floats) -> Iterator[tuple[Wave, int]]:
    """The best wave over time of each of x, y and yaw as they are seen, with the number that were tried."""
    rows, n = at.rows, len(moved)
    A, J = rows[:, :, :N_NUISANCE], rows[:, :, N_NUISANCE : N_NUISANCE + n]
    carried = rows[:, :, N_NUISANCE + n : -1]
    size = int(np.diff(at.first).max())
    slope, mean, counts = np.empty(rows.shape[:2]), np.zeros((3, size, size)), np.zeros((size, size))
    for s, (a, b) in enumerate(itertools.pairwise(at.first)):
        r = rows[a:b, :, -1] - J[a:b] @ moved - carried[a:b] @ acts[s]
        own, V = A[a:b], at.terms.V[s]
        slope[a:b] = weights[s] * (r - own @ (V @ np.einsum("ncz,nc->z", own, r)))
        for c in range(3):
            P = np.eye(b - a) - own[:, c] @ V @ own[:, c].T
            mean[c, : b - a, : b - a] += weights[s] * P
        counts[: b - a, : b - a] += 1.0
    gap = float(np.median(np.diff(at.seen_s)[np.diff(at.seen_s) > 0.0]))
    lag = (np.arange(size)[:, None] - np.arange(size)) * gap
    for c in range(3):
        omega, sums = _fourier(slope[:, c], at.seen_s)
        g = 0.5 * np.array([np.sum(mean[c] * np.cos(w * lag)) for w in omega])
        gains = 0.5 * np.abs(sums) ** 2 / np.maximum(g, 1e-12)
        k = int(np.argmax(gains))
        functions = np.zeros((2, TRACKING_COLUMNS))
        functions[:, INTO] = TRACKING_DIRECTIONS.index(("seen_x", "seen_y", "seen_yaw")[c])
        functions[1, SHIFT] = -0.5 * np.pi
        functions[:, FIRST_WAVE + TRACKING_INPUTS.index("t")] = omega[k]
        yield Wave("pose", functions, float(gains[k])), len(gains)


def add_waves(basis: RemainderBasis, waves: list[Wave]) -> RemainderBasis:
    """The basis with cosines and sines of `waves` beside its functions, each channel's under a spread of its own."""
    body, tracking = [basis.functions], [basis.tracking]
    channel, size = list(basis.channel), list(basis.size)
    B = len(basis.functions)
    for wave in waves:
        per_unit = {"mz": basis.yaw_size, "steering": 0.1, "pose": 0.1}.get(wave.channel, 1.0)
        if wave.functions.shape[1] == COLUMNS:
            body.append(wave.functions)
            channel[B:B], size[B:B] = [f"{wave.channel}~"] * 2, [per_unit] * 2
            B += 2
        else:
            tracking.append(wave.functions)
            channel += [f"{wave.channel}~"] * 2
            size += [per_unit] * 2
    return basis._replace(
        functions=np.concatenate(body),
        tracking=np.concatenate(tracking),
        channel=tuple(channel),
        size=np.array(size),
        price=basis.price + sum(w.price for w in waves),
    )

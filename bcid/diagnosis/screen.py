"""Which effects are worth a refit: a score test of each at a few trial sizes, the base parameters projected out.

Differences are taken at sizes that matter, never extrapolated from zero: some effects have no slope there.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.diagnosis.hypothesis import Hypothesis
from bcid.diagnosis.marginal import eliminate, weights
from bcid.diagnosis.refit import Fit, jacobian, residuals
from bcid.diagnosis.segments import wrapped
from bcid.diagnosis.take import Floats, Take
from bcid.effects.entry import Effect
from bcid.effects.table import EFFECTS

SHARES = (0.5, 1.5)  # trial sizes
PLACES = 5  # across the longer side of what was driven
MOMENTS = 8  # in the recording
LARGEST = 3.0  # an amplitude beyond this multiple of the trial is not believed


class Candidate(NamedTuple):
    """An effect, where its refit should start, and what the score test promises (nats)."""

    effect: str
    values: list[float]
    score: float


def _places(effect: Effect, take: Take) -> list[dict[str, float]]:
    """Trial values of the parameters that are places or times; one empty choice where there are none."""
    symbols = [p.symbol for p in effect.parameters if p.places]
    if not symbols:
        return [{}]
    if "t_s" in symbols:
        return [{"t_s": share * take.T} for share in np.linspace(0.0, 0.9, MOMENTS)]
    low, high = take.pose[:, :2].min(axis=0), take.pose[:, :2].max(axis=0)
    spacing = float((high - low).max()) / PLACES
    counts = np.maximum(np.round((high - low) / spacing).astype(int), 1)
    reach = spacing if "r_0" in symbols else 0.0  # a cable may be fixed outside of what was driven
    axes = [
        np.linspace(a - reach, b + reach, n + 1) if reach else a + (np.arange(n) + 0.5) * (b - a) / n
        for a, b, n in zip(low, high, counts, strict=True)
    ]
    rest = {"radius": 0.75 * spacing} if "radius" in symbols else {"r_0": 0.5 * spacing}
    return [{"x": float(x), "y": float(y), **rest} for x, y in itertools.product(*axes)]


def trials(effect: Effect, take: Take) -> list[list[list[float]]]:
    """Groups of parameter vectors; the members of a group are combined linearly (several amplitudes of one effect)."""
    amplitudes = [i for i, p in enumerate(effect.parameters) if not p.places]
    groups = []
    for place in _places(effect, take):
        still = [place.get(p.symbol, p.off) for p in effect.parameters]
        for share in SHARES if len(place) == 0 else SHARES[:1]:
            for sign in _signs(effect):
                group = []
                for i in amplitudes:
                    values = list(still)
                    values[i] = sign * share * effect.parameters[i].size
                    group.append(values)
                groups.append(group)
    return groups


def _signs(effect: Effect) -> tuple[float, ...]:
    signed = all(p.low < 0.0 for p in effect.parameters if not p.places)
    one = sum(not p.places for p in effect.parameters) == 1
    return (1.0, -1.0) if signed and one else (1.0,)


def screen(fit: Fit, take: Take, left_out: tuple[str, ...] = ()) -> list[Candidate]:
    """The best trial of every effect that `fit` does not hold, most promising first."""
    names = [n for n in EFFECTS if n not in (*fit.hypothesis.effects, *left_out)]
    setting = fit.hypothesis.setting(fit.phi, take)
    r = residuals(take, setting, fit.start)
    J = jacobian(take, fit.hypothesis, fit.phi, fit.start)
    owners: list[tuple[str, list[list[float]], slice]] = []
    columns = [J]
    at = J.shape[2]
    for name in names:
        for group in trials(EFFECTS[name], take):
            columns += [_difference(fit, take, name, values, r) for values in group]
            owners.append((name, group, slice(at, at + len(group))))
            at += len(group)
    e = eliminate(r, fit.A, np.concatenate(columns, axis=2), take.first, fit.scales.r, fit.scales.free_variances())
    w = weights(e)
    g, G = np.einsum("s,sn->n", w, e.g), np.einsum("s,snm->nm", w, e.G)
    base = slice(0, J.shape[2])
    explained = np.linalg.lstsq(G[base, base], G[base, :], rcond=None)[0]
    g_left, G_left = g - explained.T @ g[base], G - G[:, base] @ explained
    best: dict[str, Candidate] = {}
    for name, group, own in owners:
        found = _scored(name, group, g_left[own], G_left[own, own])
        if name not in best or found.score > best[name].score:
            best[name] = found
    return sorted(best.values(), key=lambda c: -c.score)


def _difference(fit: Fit, take: Take, name: str, values: list[float], r: Floats) -> Floats:
    """What the effect at `values` changes in the prediction (N, 3, 1)."""
    base = fit.hypothesis
    more: Hypothesis = replace(base, effects=(*base.effects, name))
    phi = more.start(base.car(fit.phi), [*base.values(fit.phi).values(), *values])
    return wrapped(r - residuals(take, more.setting(phi, take), fit.start))[:, :, None]


def _scored(name: str, group: list[list[float]], g: Floats, G: Floats) -> Candidate:
    """The amplitudes of the group's members that fit best, and what they gain."""
    if np.any(np.diag(G) <= 1e-9):
        return Candidate(name, group[0], 0.0)  # the take does not excite it there
    amplitude = np.linalg.solve(G + 1e-9 * np.diag(np.diag(G)), g)
    if len(group) == 1:
        amplitude = np.clip(amplitude, 0.0, LARGEST)
    gain = float(amplitude @ g - 0.5 * amplitude @ G @ amplitude)
    values = [
        sum(a * member[i] for a, member in zip(amplitude, group, strict=True)) if not p.places else group[0][i]
        for i, p in enumerate(EFFECTS[name].parameters)
    ]
    return Candidate(name, [float(v) for v in values], gain)

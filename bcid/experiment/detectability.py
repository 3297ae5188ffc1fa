"""The smallest size of each effect that a take would show, before anything is driven or fitted.

An effect shows where the expected gain of its refit, a^2 G / 2 with G the information about its amplitude that the
base parameters leave, reaches what a diagnosis asks of it: GATE nats, and half a logarithm of the segments per
parameter.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.effects.entry import Effect, Parameter
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Scales
from bcid.likelihood.newton import Tangent, jacobian
from bcid.likelihood.nuisance import residuals, sensitivities
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import GATE, UNSEEN, changes_of, projected
from bcid.likelihood.take import Take

ROUNDS = 6  # of finding the smallest size: an effect need not grow with its square
LARGEST_STEP = 4.0  # of the size in one round
FURTHEST = 50.0  # times the declared size that is still tried
NEAR = 0.02  # relative, at which the size is found
MOST_PLACES = 4  # along each side of the floor
SHOWN = 0.5  # share of an effect's places in which it must show

Sizes = dict[str, tuple[float, str]]
"""Value and unit of each of an effect's amplitudes."""


class Option(NamedTuple):
    """One amplitude of one effect at one place."""

    effect: str
    which: int  # of its parameters
    parameter: Parameter
    values: list[float]  # of all its parameters

    def at(self, size: float) -> Option:
        """The same with another amplitude."""
        return self._replace(values=[*self.values[: self.which], size, *self.values[self.which + 1 :]])


def options_of(names: Sequence[str], take: Take, hypothesis: Hypothesis) -> list[Option]:
    """The amplitudes of the effects, at their declared size, in each of some typical places."""
    entries = hypothesis.entries
    return [
        Option(name, i, p, [place.get(q.symbol, q.off) for q in entries[name].parameters]).at(p.size)
        for name in names
        for place in _places(entries[name], take)
        for i, p in enumerate(entries[name].parameters)
        if not p.places
    ]


def _places(effect: Effect, take: Take) -> list[dict[str, float]]:
    """Where an effect may be: circles over the floor that was driven, a cable from any side of it, any time."""
    symbols = [p.symbol for p in effect.places]
    if not symbols:
        return [{}]
    if "t_s" in symbols:
        return [{"t_s": share * float(take.length_s.max())} for share in (0.3, 0.5, 0.7)]
    low, high = np.quantile(take.pose[:, :2], 0.02, axis=0), np.quantile(take.pose[:, :2], 0.98, axis=0)
    if "radius" in symbols:
        radius = next(p.size for p in effect.parameters if p.symbol == "radius")
        counts = np.clip(np.round((high - low) / (2.0 * radius)), 1, MOST_PLACES).astype(int)
        axes = [np.linspace(a, b, n + 2)[1:-1] for a, b, n in zip(low, high, counts, strict=True)]
        return [{"x": float(x), "y": float(y), "radius": radius} for x, y in itertools.product(*axes)]
    sides = [(0.0, 0.5), (1.0, 0.5), (0.5, 0.0), (0.5, 1.0)]
    slack = {p.symbol: p.size for p in effect.places if p.symbol == "r_0"}
    return [dict(zip("xy", (low + (high - low) * side).tolist(), strict=True)) | slack for side in sides]


def needed(effect: Effect, segments: int) -> float:
    """Nats that the effect must be expected to gain."""
    return GATE + 0.5 * len(effect.parameters) * math.log(max(segments, 1))


def fit_at(hypothesis: Hypothesis, phi: Floats, scales: Scales, take: Take) -> Fit:
    """A fit as if phi had been found in the take: its tangent, without a likelihood."""
    setting = hypothesis.setting(phi, take)
    r = residuals(take, setting, take.start)
    J = jacobian(take, hypothesis, phi, take.start, r, range(hypothesis.base_size))
    nothing = np.zeros(take.segments)
    covariance = np.full((hypothesis.size, hypothesis.size), np.nan)
    return Fit(
        hypothesis, phi, take.start, scales, np.nan, nothing, covariance,
        Tangent(sensitivities(take, setting, take.start), J),
    )  # fmt: skip


def detectable(
    hypothesis: Hypothesis, phi: Floats, scales: Scales, take: Take, effects: Sequence[str]
) -> dict[str, Sizes | None]:
    """The smallest size of each effect that `take` would show, by symbol, with its unit.

    None where the take does not excite the effect within its bounds.  Of an effect with a place or a time, the
    median over several, and none unless half of them show it.  What `hypothesis` holds already is left out.
    """
    fit = fit_at(hypothesis, phi, scales, take)
    names = [n for n in effects if n not in hypothesis.effects]
    options = options_of(names, take, hypothesis)
    need = np.array([needed(fit.hypothesis.entries[o.effect], take.segments) for o in options])
    sizes = smallest(fit, take, options, need) if options else []
    found: dict[str, Sizes | None] = {}
    for name in names:
        seen: Sizes = {}
        for p in hypothesis.entries[name].amplitudes:
            here = [s for o, s in zip(options, sizes, strict=True) if (o.effect, o.parameter) == (name, p)]
            if np.isfinite(here).mean() >= SHOWN:
                seen[p.symbol] = (float(np.sort(here)[int(SHOWN * (len(here) - 1))]), p.unit)
        found[name] = seen or None
    return found


def smallest(fit: Fit, take: Take, options: list[Option], need: Floats) -> list[float]:
    """The amplitude of each option that is expected to gain what it needs; inf where none within reach does."""
    sizes = np.array([o.values[o.which] for o in options])
    highest = np.minimum([o.parameter.high for o in options], FURTHEST * sizes)
    too_small, enough = np.zeros(len(options)), np.full(len(options), np.inf)
    open_ = np.arange(len(options))
    for _ in range(ROUNDS):
        now = sizes[open_]
        gains = gains_of(fit, take, [options[i].at(s) for i, s in zip(open_, now.tolist(), strict=True)])
        shows = gains >= need[open_]
        too_small[open_] = np.where(shows, too_small[open_], now)
        enough[open_] = np.where(shows, now, enough[open_])
        step = np.clip(np.sqrt(need[open_] / np.maximum(gains, UNSEEN)), 1.0 / LARGEST_STEP, LARGEST_STEP)
        low, high = too_small[open_], np.minimum(enough, highest)[open_]
        after = np.minimum(now * step, highest[open_])
        after = np.where((after > low) & (after < enough[open_]), after, np.sqrt(low * high))
        going = (np.abs(after / now - 1.0) >= NEAR) & (low < highest[open_])
        sizes[open_] = np.where(going, after, now)
        open_ = open_[going]
        if len(open_) == 0:
            break
    return [float(s) for s in np.where(np.isfinite(enough), sizes, np.inf)]


def gains_of(fit: Fit, take: Take, options: Sequence[Option]) -> Floats:
    """What refits with the options, each alone, are expected to gain (nats) if they are true."""
    tried = changes_of(fit, take, [(o.effect, [o.values]) for o in options])
    return np.asarray(0.5 * np.diag(projected(fit, take, tried.columns).G))

"""Which effects are worth a refit: a score test of each at a few trial sizes, the base parameters projected out.

Differences are taken at sizes that matter, never extrapolated from zero: some effects have no slope there.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.locate.pushes import disturbances
from bcid.diagnosis.locate.scan_statistic import circles
from bcid.diagnosis.search.trials import MOMENTS, trials_of
from bcid.effects.table import ENTRIES
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import (
    Changes,
    Trial,
    best_amplitude,
    changed_in,
    changes_of,
    level,
    null_maxima,
    projected,
    promise,
)
from bcid.likelihood.take import Take

ODD_PLACES = 4
SHARPER = 1.0  # nats that a move must gain
CHANCE = 1e-4  # that a take of nothing passes a gate
FINEST = 0.04  # share of the first width at which places are sharp


class Candidate(NamedTuple):
    """An effect, where its refit should start, and what the score test promises (nats)."""

    effect: str
    values: list[float]
    score: float


class Nulls(NamedTuple):
    """What nothing at all promises on this take (nats)."""

    p_value: float  # that the best of all trials is chance
    level: float  # that one take of nothing in ten thousand reaches
    local_level: float  # the same by effects local in place or time alone
    placebos: list[Candidate]  # trials carried elsewhere in the take, best first

    @property
    def gate(self) -> float:
        """What an effect must earn: more than chance, and more than any placebo."""
        return max(self.level, self.placebos[0].score)

    @property
    def local_gate(self) -> float:
        """What an effect local in place or time must earn on blocks it has not seen."""
        return max(self.local_level, self.placebos[0].score)


def changes(fit: Fit, take: Take) -> Changes:
    """The trials of all entries that `fit` does not hold: about 150 simulations of the take."""
    odd = circles(disturbances(fit, take), fit.hypothesis.units, ODD_PLACES)[0]
    rows = [
        (name, vectors)
        for name, effect in fit.hypothesis.entries.items()
        if name not in fit.hypothesis.effects
        for vectors in trials_of(effect, take, odd)
    ]
    return changes_of(fit, take, rows)


def sharpened(fit: Fit, take: Take, candidate: Candidate) -> Candidate:
    """The candidate with its places and times moved to where it promises most; others as they are.

    A pattern search, one place at a time and then two together: a place has no useful slope far away from it.
    """
    parameters = fit.hypothesis.entries[candidate.effect].parameters
    places = [i for i, p in enumerate(parameters) if p.places]
    if not places or candidate.score <= 0.0:
        return candidate
    single = [((i, sign),) for i in places for sign in (1.0, -1.0)]
    double = [(a, b) for (a,), (b,) in itertools.combinations(single, 2) if a[0] != b[0]]
    share, best = 1.0, candidate
    while share > FINEST:
        for moves in (single, double):
            found = _moved(fit, take, best, moves, share)
            if found.score > best.score + SHARPER:
                best = found
                break
        else:
            share *= 0.5
    return best


def _moved(
    fit: Fit, take: Take, candidate: Candidate, moves: Sequence[tuple[tuple[int, float], ...]], share: float
) -> Candidate:
    """The most promising of the candidate's neighbours in its places."""
    metre = fit.hypothesis.units.reach
    moment = float(take.length_s.max()) / MOMENTS
    widths = {"t_s": moment, "x": 0.6 * metre, "y": 0.6 * metre, "radius": 0.4 * metre, "r_0": 0.6 * metre}
    parameters = fit.hypothesis.entries[candidate.effect].parameters
    rows = []
    for move in moves:
        values = candidate.values
        for i, sign in move:
            p = parameters[i]
            values = changed_in(values, i, min(max(values[i] + sign * share * widths[p.symbol], p.low), p.high))
        rows.append((candidate.effect, [values]))
    if not rows:
        return candidate
    tried = changes_of(fit, take, rows)
    found = projected(fit, take, tried.columns)
    trial, amplitude, score = max(
        ((t, *best_amplitude(found, t.own)) for t in tried.trials), key=lambda option: option[2]
    )
    return Candidate(candidate.effect, _values(trial, amplitude), score)


def screen(fit: Fit, take: Take, trials: Changes) -> list[Candidate]:
    """The best trial of every effect, most promising first.

    What a trial gains is counted in the robust likelihood itself, since a segment that it explains may have
    been given hardly any weight.
    """
    found = projected(fit, take, trials.columns)
    return _ranked((t, *best_amplitude(found, t.own)) for t in trials.trials)


def _ranked(scored: Iterable[tuple[Trial, Floats, float]]) -> list[Candidate]:
    best: dict[str, Candidate] = {}
    for trial, amplitude, score in scored:
        if trial.effect not in best or score > best[trial.effect].score:
            best[trial.effect] = Candidate(trial.effect, _values(trial, amplitude), score)
    return sorted(best.values(), key=lambda c: -c.score)


def nulls(fit: Fit, take: Take, trials: Changes) -> Nulls:
    """How promising chance looks: by signs drawn anew, and by placebos.

    A placebo is a trial's change carried to segments half a take away, where it has nothing to explain.
    """
    found = projected(fit, take, trials.columns)
    local = [t.own for t in trials.trials if ENTRIES[t.effect].places]
    maxima = null_maxima(found, [t.own for t in trials.trials])
    best = max(promise(found, t.own) for t in trials.trials)
    elsewhere = projected(fit, take, _elsewhere(trials.columns, take))
    placebos = _ranked((t, *best_amplitude(elsewhere, t.own)) for t in trials.trials)
    return Nulls(
        (1 + int(np.sum(maxima >= best))) / (1 + len(maxima)), level(maxima, CHANCE),
        level(null_maxima(found, local), CHANCE), placebos,
    )  # fmt: skip


def _elsewhere(columns: Floats, take: Take) -> Floats:
    """The columns with whole segments half a take away from where they belong."""
    moved = np.zeros_like(columns)
    S = take.segments
    for s in range(S):
        a, b = take.first[s], take.first[s + 1]
        from_a, from_b = take.first[(s + S // 2) % S], take.first[(s + S // 2) % S + 1]
        n = min(b - a, from_b - from_a)
        moved[a : a + n] = columns[from_a : from_a + n]
    return moved


def _values(trial: Trial, amplitude: Floats) -> list[float]:
    parameters = ENTRIES[trial.effect].parameters
    return [
        trial.vectors[0][i] if p.places else float(sum(a * v[i] for a, v in zip(amplitude, trial.vectors, strict=True)))
        for i, p in enumerate(parameters)
    ]

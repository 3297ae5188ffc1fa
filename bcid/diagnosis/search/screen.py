"""The score test of every effect at a few trial sizes, the base parameters projected out: which are worth a refit.

Differences are taken at sizes that matter, never extrapolated from zero: some effects have no slope there.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.kept_steps import kept_under
from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.locate.pushes import estimate_disturbances
from bcid.diagnosis.locate.scan_statistic import FloorCircle, scan_circles
from bcid.effects.entry import Effect
from bcid.effects.table import ENTRIES
from bcid.likelihood import score_test
from bcid.likelihood.projection import LinearisedFit, ProjectedChanges, linearise_fit, project_out_fit
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import Trial, TrialChanges, compute_trial_changes, replace_value
from bcid.likelihood.take import Take

# multiples of an effect's declared size: at the least nothing shows of one that bends at zero (a dead zone), and at the
# whole size a small one of another seems contradicted, where recordings are so precise that predictions bend
WHOLE, SMALL = 1.0, 0.1
TRIAL_SIZES, SIGNED_TRIAL_SIZES = (SMALL, 0.5, 1.5), (WHOLE, -WHOLE, SMALL, -SMALL)

# cells of the grid along the longer side of the floor that was driven, and times in a recording
GRID_CELLS, TRIAL_TIMES = 5, 8

# multiples of a conspicuous circle's radius: a trial circle within the true one shows the effect, a wider one does not
TRIAL_RADII = (0.3, 0.5, 0.7, 1.0)

CONSPICUOUS_CIRCLES = 4

# a place is moved if that gains so many nats, by halved steps down to this share of the first
MIN_MOVE_NATS, FINEST_SHARE = 1.0, 0.04

# first steps, of a vehicle as large and as fast as the bumper car
FIRST_STEPS_M = {"x": 0.6, "y": 0.6, "radius": 0.4, "r_0": 0.6}


class CandidateEffect(NamedTuple):
    """An effect that is worth a refit, and the parameter values from which it starts."""

    effect: str
    values: list[float]  # of its parameters, where the refit starts
    score: float  # nats that the score test promises


class NullGains(NamedTuple):
    """The gains (nats) that effects reach on this take by chance alone."""

    chance_level: float  # that the best of all trials exceeds with SEARCH_LIMITS.gate_p_value
    placebos: list[CandidateEffect]  # trials carried elsewhere in the take, best first
    levels: Mapping[str, float] = MappingProxyType({})  # by effect; that any of all exceeds its own is no likelier

    @property
    def gate(self) -> float:
        """Nats that all effects together hardly gain by chance, with a tail of e⁻ˣ: for what is none of them."""
        return max(self.chance_level, max((c.score for c in self.placebos), default=0.0))

    def gate_of(self, effect: str) -> float:
        """Nats that an `effect` must gain: more than it does by chance, and more than as a placebo.

        One with many places and times, or that shows in few segments, gains more by chance than others do.
        """
        if effect not in self.levels:
            return self.gate
        return max(self.levels[effect], *(c.score for c in self.placebos if c.effect == effect), 0.0)


NO_NULLS = NullGains(0.0, [])
"""Before any are drawn."""


@kept_under()
def simulate_trials(fit: Fit, take: Take) -> TrialChanges:
    """Changes of the predicted poses by every trial: an effect that `fit` lacks, switched on at one size and one place.

    Sizes are near those declared with the effect; places include circles on the floor where disturbances are largest.
    """
    circles = scan_circles(estimate_disturbances(fit, take), fit.hypothesis.units, CONSPICUOUS_CIRCLES)[0]
    rows = [
        (name, vectors)
        for name, effect in fit.hypothesis.entries.items()
        if name not in fit.hypothesis.effects
        for vectors in _trial_vectors(effect, take, circles)
    ]
    return compute_trial_changes(fit, take, rows)


def _trial_vectors(effect: Effect, take: Take, circles: Sequence[FloorCircle]) -> Iterator[list[list[float]]]:
    """Parameter vectors (SI) of an effect for the score test, in lists of vectors that the test combines linearly.

    A list has a vector for each amplitude of the effect, at one of its `_trial_multiples` times its declared size.  An
    effect with a place is tried at all `_trial_places`, of which some are in the `circles`.
    """
    amplitudes, multiples = [i for i, p in enumerate(effect.parameters) if not p.is_place], _trial_multiples(effect)
    for place in _trial_places(effect, take, circles):
        still = [place.get(p.symbol, p.off) for p in effect.parameters]
        for multiple in multiples:
            yield [replace_value(still, i, multiple * effect.parameters[i].size) for i in amplitudes]


def _trial_multiples(effect: Effect) -> tuple[float, ...]:
    """Multiples of its declared size at which an effect is tried; one with a place, of which there are many, at that.

    Of several amplitudes the test finds the signs.
    """
    first, *further = [p for p in effect.parameters if not p.is_place]
    if further:
        return (WHOLE,) if effect.place_parameters else (WHOLE, SMALL)
    if first.low < 0.0:
        return (WHOLE, -WHOLE) if effect.place_parameters else SIGNED_TRIAL_SIZES
    return (WHOLE,) if effect.place_parameters else TRIAL_SIZES


def _trial_places(effect: Effect, take: Take, circles: Sequence[FloorCircle]) -> list[dict[str, float]]:
    """Trial values, by symbol, of the place and time parameters of an effect, one dict each; [{}] for one without any.

    Times are spread over the recording.  Places lie on a grid over the floor that was driven and, with a radius, also
    in the `circles` on the floor where disturbances are largest.
    """
    symbols = [p.symbol for p in effect.place_parameters]
    if not symbols:
        return [{}]
    if "t_s" in symbols:
        return [{"t_s": share * float(take.length_s.max())} for share in np.linspace(0.1, 0.9, TRIAL_TIMES)]
    low, high = np.quantile(take.pose[:, :2], 0.01, axis=0), np.quantile(take.pose[:, :2], 0.99, axis=0)
    spacing = float((high - low).max()) / GRID_CELLS
    counts = np.maximum(np.round((high - low) / spacing).astype(int), 1)
    # a cable may be fixed outside of the floor that was driven
    reach = spacing if "r_0" in symbols else 0.0
    axes = [
        np.linspace(a - reach, b + reach, n + 1) if reach else a + (np.arange(n) + 0.5) * (b - a) / n
        for a, b, n in zip(low, high, counts, strict=True)
    ]
    rest = {"radius": 0.75 * spacing} if "radius" in symbols else {"r_0": 0.5 * spacing}
    grid = [{"x": float(x), "y": float(y), **rest} for x, y in itertools.product(*axes)]
    if "radius" in symbols:
        grid += [{"x": c.x, "y": c.y, "radius": share * c.radius} for c in circles for share in TRIAL_RADII]
    return grid


def sharpen_places(fit: Fit, take: Take, candidate: CandidateEffect) -> CandidateEffect:
    """The candidate with its place or time moved to where the score test beside `fit` promises the largest gain (nats).

    A pattern search moves one coordinate or two at a time by steps that are halved, since far from a place the
    likelihood has no gradient.  A candidate without a place, or of no gain, is returned unchanged.
    """
    parameters = fit.hypothesis.entries[candidate.effect].parameters
    places = [i for i, p in enumerate(parameters) if p.is_place]
    if not places or candidate.score <= 0.0:
        return candidate
    single = [((i, sign),) for i in places for sign in (1.0, -1.0)]
    double = [(a, b) for (a,), (b,) in itertools.combinations(single, 2) if a[0] != b[0]]
    share, best, linearised = 1.0, candidate, linearise_fit(fit, take)
    while share > FINEST_SHARE:
        for moves in (single, double):
            found = _best_neighbour(fit, linearised, take, best, moves, share)
            if found.score > best.score + MIN_MOVE_NATS:
                best = found
                break
        else:
            share *= 0.5
    return best


def _best_neighbour(
    fit: Fit, linearised: LinearisedFit, take: Take, candidate: CandidateEffect,
    moves: Sequence[tuple[tuple[int, float], ...]], share: float,
) -> CandidateEffect:  # fmt: skip
    """The candidate of largest score-test gain among those to which each of the `moves` leads from `candidate`.

    A move is a tuple of (index of a parameter, sign) pairs; each changes its parameter by `share` of its first step
    (FIRST_STEPS_M, scaled to the vehicle; for a time, the recording's length over TRIAL_TIMES).  Values are clipped to
    bounds.  `linearised` is the fit's linearisation.
    """
    factor = fit.hypothesis.units.circle_factor
    widths = {symbol: step * factor for symbol, step in FIRST_STEPS_M.items()}
    widths["t_s"] = float(take.length_s.max()) / TRIAL_TIMES
    parameters = fit.hypothesis.entries[candidate.effect].parameters
    rows = []
    for move in moves:
        values = candidate.values
        for i, sign in move:
            p = parameters[i]
            values = replace_value(values, i, min(max(values[i] + sign * share * widths[p.symbol], p.low), p.high))
        rows.append((candidate.effect, [values]))
    if not rows:
        return candidate
    trials = compute_trial_changes(fit, take, rows, linearised.r)
    return _rank_candidates(project_out_fit(linearised, trials.columns, trials.widest), trials.trials)[0]


@kept_under()
def screen_effects(fit: Fit, take: Take, trials: TrialChanges) -> list[CandidateEffect]:
    """The effects by the gain (nats) that a score test beside `fit` predicts, each with its best trial, best first.

    A trial is an effect at one size and place, and `trials` holds its change of the predicted poses; the best multiple
    of it is found.  Gains are by Student's t likelihood, in which a segment that a trial explains may have had hardly
    any weight.
    """
    return _rank_candidates(project_out_fit(linearise_fit(fit, take), trials.columns, trials.widest), trials.trials)


def _rank_candidates(changes: ProjectedChanges, trials: Sequence[Trial]) -> list[CandidateEffect]:
    """Each effect with its best trial (a size and place), by the gain of Student's t likelihood, largest first.

    `changes` are the trials' changes of the predicted poses, less what the fit's own parameters can imitate.  A
    candidate's values are the trial's, times the best multiples.
    """
    best: dict[str, CandidateEffect] = {}
    all_amplitudes, scores = score_test.robust_amplitudes(changes, [t.own for t in trials])
    for trial, amplitudes, score in zip(trials, all_amplitudes, scores.tolist(), strict=True):
        if trial.effect not in best or score > best[trial.effect].score:
            best[trial.effect] = CandidateEffect(trial.effect, combine_vectors(trial, amplitudes), score)
    return sorted(best.values(), key=lambda c: -c.score)


@kept_under("gate_p_value")
def sample_null_gains(fit: Fit, take: Take, trials: TrialChanges) -> NullGains:
    """Gains (nats) that `trials`, effects at one size and place, reach beside `fit` by chance.

    Chance is drawn by giving each segment's residuals a random sign (a wild bootstrap), and by placebos: each trial's
    change of the predicted poses moved to segments half a take away, where it has nothing to explain.
    """
    linearised = linearise_fit(fit, take)
    changes = project_out_fit(linearised, trials.columns, trials.widest)
    gains = score_test.null_gains(changes, [t.own for t in trials.trials])
    most = np.array([score_test.greatest_null_gain(changes, t.own) for t in trials.trials])
    p, effects = SEARCH_LIMITS.gate_p_value, np.array([t.effect for t in trials.trials])
    levels = dict[str, float]()
    for effect in np.unique(effects).tolist():
        own, among = gains[effects == effect].max(axis=0), p / len(set(effects.tolist()))
        level = score_test.null_quantile(own, among, score_test.tail_scale(own))
        levels[effect] = min(level, float(most[effects == effect].max()))
    # of all together: with its own scale the effect of the slowest tail would rule what is said of all else
    level = score_test.null_quantile(gains.max(axis=0, initial=0.0), p)
    elsewhere = project_out_fit(linearised, trials.columns, trials.widest, moved=take.segments // 2)
    return NullGains(level, _rank_candidates(elsewhere, trials.trials), levels)


def combine_vectors(trial: Trial, amplitudes: Floats) -> list[float]:
    """Parameter values (SI) of an effect: the trial's vectors times `amplitudes`, summed; places and times are kept."""
    return [
        trial.vectors[0][i]
        if p.is_place
        else float(sum(a * v[i] for a, v in zip(amplitudes, trial.vectors, strict=True)))
        for i, p in enumerate(ENTRIES[trial.effect].parameters)
    ]

"""Joint refits with one effect more from its best size, where a score test says nothing of what an effect does.

That is so beside pushes that do the effect's work already, and beside parameters that have bent to what is missing.
"""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.search.refits import effects_at_bounds
from bcid.effects.entry import Parameter
from bcid.effects.table import EFFECTS
from bcid.likelihood.divergence import map_converged, none_if_diverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Scales
from bcid.likelihood.refit import Fit, refit, segment_log_likelihoods
from bcid.likelihood.take import Take

# an effect's size is found on few segments, effects are compared on more
SEGMENTS_FOR_SIZES, SEGMENTS_FOR_EFFECTS = 12, 30

# after fewer tangents, a size found on few segments may not suit the others yet
TRIAL_TANGENTS = 3

COARSE_MULTIPLES, FINE_MULTIPLES = (1.0, 3.0, 9.0, 27.0, 81.0), (0.6, 1.7)
"""Multiples of an effect's declared size that are tried, and then of the best of them.

Sizes are declared for the bumper car; for its mass, a small car may have far larger ones.
"""

# a single size that is worse than the one before may owe that to a bad prediction of one segment
MAX_FALLS = 2

# best sizes from which a refit is tried
MAX_STARTS = 2

AMPLITUDE_DIRECTIONS = ((1.0, 1.0), (1.0, -1.0), (1.0, 0.0), (0.0, 1.0))
"""Directions in which effects of two amplitudes are tried."""


def phi_at_reference(fit: Fit) -> Floats:
    """The fit's parameter vector phi with a trusted reference model's own values in place of the refitted ones.

    phi holds the base parameters (logarithms, drag), then the effects' parameters in units of their declared sizes.
    Refitted base parameters may hide what is missing.
    """
    hypothesis, reference = fit.hypothesis, fit.hypothesis.trusted_simulation
    assert reference is not None  # noqa: S101  # only fits beside a trusted reference model get here
    # the base model and what is assumed come first
    phi = np.array([*reference.phi, *fit.phi[len(reference.phi) :]])
    return np.where(np.isin(hypothesis.parameter_names, reference.free), fit.phi, phi)


def effects_without_place(fit: Fit, excluded: Sequence[str]) -> tuple[str, ...]:
    """Ids of the effects without a place or time parameter, leaving out those that `fit` holds and those `excluded`."""
    entries, held = fit.hypothesis.entries, fit.hypothesis.effects
    own = [entries[n] for n in EFFECTS if n in entries and n not in (*held, *excluded)]
    return tuple(e.id for e in own if e.amplitude_parameters and not e.place_parameters)


class SizedRefit(NamedTuple):
    """A joint refit with one effect more on a part of a take, from the effect's best size there."""

    fit: Fit
    promise: float  # nats that the effect gains on that part
    sd: float  # of the promise, by the scatter of segments

    @property
    def effect(self) -> str:
        """Id of the effect that was added last."""
        return self.fit.hypothesis.effects[-1]


def refit_from_sizes(
    fit: Fit, take: Take, effects: Iterable[str], required_nats: float
) -> tuple[list[Fit], tuple[str, ...]]:
    """Joint refits of `fit` with one more of the `effects`, each started from its best size on a part of the take.

    Sizes, multiples of the declared one, and effects are first compared on 12 and 30 of the take's 1.5 s segments.
    Only effects likely to gain `required_nats` of penalised log-likelihood are then refitted on the whole take.  A
    trusted reference model's parameters start from its own values.  The second value holds the ids of the most
    promising effects, best first.
    """
    effects = [n for n in effects if n not in fit.hypothesis.effects]
    if not effects:
        return [], ()
    phi = fit.phi if fit.hypothesis.trusted_simulation is None else phi_at_reference(fit)
    sized = search_sizes(fit, take, phi, effects)
    return refit_on_whole_take(fit, take, sized, required_nats), tuple(s.effect for s in sized)


def search_sizes(fit: Fit, take: Take, phi: Floats, effects: Sequence[str]) -> list[SizedRefit]:
    """Refits of the fit with one of the `effects` each, on a part of the take, from its best size; best gain first.

    Sizes are multiples of the declared one; at most `SEARCH_LIMITS.max_sized_effects` refits are returned.  Other
    parameters start from the parameter vector `phi`.  A trusted reference model's log prior counts by the part's share
    of the take.
    """
    few, enough = (_spread_segments(take, n) for n in (SEGMENTS_FOR_SIZES, SEGMENTS_FOR_EFFECTS))
    part, hypothesis = take.part(enough), fit.hypothesis.scale_simulation_prior(len(enough) / take.segments)
    null, sized = _fit_null(fit, part, enough, hypothesis, phi), list[SizedRefit]()
    for name in effects:
        starts = [hypothesis.add_effect(name, phi, s) for s in _rank_sizes(fit, take, few, name, phi)[:MAX_STARTS]]
        more = _refit_first_feasible(part, starts, fit.start[enough], fit.scales)
        sized += [_score_refit(more, null, take.segments)] if more else []
    return sorted(sized, key=lambda s: -s.promise)[: SEARCH_LIMITS.max_sized_effects]


class _NullFit(NamedTuple):
    """The fit of a part of a take without one effect more."""

    per_segment: Floats  # (S,) log-likelihood
    log_prior: float

    def segment_gains(self, fit: Fit) -> Floats:
        """Nats (S,) by which `fit` is likelier in each segment, saturated."""
        return _saturate(fit.per_segment - self.per_segment)


def _fit_null(fit: Fit, part: Take, chosen: Ints, hypothesis: Hypothesis, phi: Floats) -> _NullFit:
    """Log-likelihoods and log prior of the fit without a further effect, on the segments `chosen`, which form `part`.

    They are the fit's own, or those of a refit of the `hypothesis` from `phi` to these segments if that fits them
    better: an effect's gain is measured against it, so that what any refit to few segments gains is not credited to
    the effect.
    """
    null = _NullFit(fit.per_segment[chosen], fit.log_prior * len(chosen) / len(fit.per_segment))
    again = _refit_first_feasible(part, [(hypothesis, phi)], fit.start[chosen], fit.scales)
    if again and null.segment_gains(again).sum() + again.log_prior - null.log_prior > 0.0:
        return _NullFit(again.per_segment, again.log_prior)
    return null


def _refit_first_feasible(
    part: Take, starts: Iterable[tuple[Hypothesis, Floats]], start: Floats, scales: Scales
) -> Fit | None:
    """The first refit to `part` that does not diverge, from `starts` (hypothesis, phi) in turn; None if all diverge.

    phi is the hypothesis's parameter vector.  All begin at the segments' initial states and disturbances `start` (S,
    N_NUISANCE) and the standard deviations `scales` of pose noise and disturbances.
    """
    trial = partial(refit, tangents=TRIAL_TANGENTS)
    return next(map_converged(trial, ((part, *first, start, scales) for first in starts)), None)


def _rank_sizes(fit: Fit, take: Take, chosen: Ints, name: str, phi: Floats) -> list[tuple[float, ...]]:
    """Parameter values (SI) of effect `name`, by their gain of log-likelihood on the `chosen` segments, largest first.

    The values are multiples of the declared sizes; all other parameters stay at the parameter vector `phi`.  After
    MAX_FALLS values in a row that gain less than the one before, no larger one is tried; values at which predictions
    diverge are left out.
    """
    part, own = take.part(chosen), fit.hypothesis.entries[name].parameters
    gains = dict[tuple[float, ...], float]()

    def gain_at(sizes: tuple[float, ...]) -> float:
        """Saturated nats that the effect gains at these parameter values, computed once for each."""
        if sizes not in gains:
            more = fit.hypothesis.add_effect(name, phi, sizes)
            each = none_if_diverged(segment_log_likelihoods, part, *more, fit.start[chosen], fit.scales)
            gains[sizes] = -np.inf if each is None else float(_saturate(each - fit.per_segment[chosen]).sum())
        return gains[sizes]

    for direction in _size_directions(own):
        last, falls = -np.inf, 0
        for multiple in COARSE_MULTIPLES:
            now = gain_at(_clip_to_bounds(own, [multiple * v for v in direction]))
            falls, last = falls + 1 if now < last or now == -np.inf else 0, now
            if falls == MAX_FALLS:
                break
    best = max(gains, key=gain_at)
    for multiple in FINE_MULTIPLES:
        gain_at(_clip_to_bounds(own, [multiple * v for v in best]))
    return sorted((sizes for sizes in gains if gains[sizes] > -np.inf), key=lambda sizes: -gains[sizes])


def _size_directions(own: Sequence[Parameter]) -> list[tuple[float, ...]]:
    """Directions (tuples, SI) in the space of an effect's parameters `own` along which a line search tries multiples.

    Components are the declared sizes; of two parameters, both with equal and with opposite sign, and each alone.  The
    opposite directions are added where all parameters may be negative.
    """
    directions = AMPLITUDE_DIRECTIONS if len(own) == 2 else ((1.0,) * len(own),)
    signs = (1.0, -1.0) if all(p.low < 0.0 for p in own) else (1.0,)
    return [tuple(sign * w * p.size for w, p in zip(d, own, strict=True)) for sign in signs for d in directions]


def _clip_to_bounds(own: Sequence[Parameter], values: Sequence[float]) -> tuple[float, ...]:
    """The values of an effect's parameters, each limited to its own bounds."""
    return tuple(min(max(v, p.low), p.high) for v, p in zip(values, own, strict=True))


def _score_refit(fit: Fit, null: _NullFit, segments: int) -> SizedRefit:
    """A refit `fit` of part of a take with its gain (nats) there over the fit `null` without the last effect of `fit`.

    The gain is a sum of saturated gains of segments plus the gain of log prior.  It is reduced, with k parameters of
    the effect and a part that is the share p of the whole take's number of `segments` S, by k/2 (p ln S + 1 - p):
    BIC's penalty for the part, and the optimism of parameters fitted to the part alone.
    """
    each, share = null.segment_gains(fit), len(fit.per_segment) / segments
    own = len(fit.hypothesis.entries[fit.hypothesis.effects[-1]].parameters)
    penalty = 0.5 * own * (share * float(np.log(segments)) + 1.0 - share)
    promise = float(each.sum()) + fit.log_prior - null.log_prior - penalty
    return SizedRefit(fit, promise, float(each.std() * np.sqrt(len(each))))


def _saturate(nats: Floats) -> Floats:
    """Gains (S,) of segments in nats, limited smoothly to +-m = `SEARCH_LIMITS.max_segment_nats`: m tanh(nats / m)."""
    most = SEARCH_LIMITS.max_segment_nats
    return np.asarray(most * np.tanh(nats / most))


def refit_on_whole_take(fit: Fit, take: Take, sized: Sequence[SizedRefit], required_nats: float) -> list[Fit]:
    """The best of the `sized` refits of part of a take, refitted to the whole take; none with an effect at a bound.

    At most `SEARCH_LIMITS.max_finalists` are refitted.  The list ends before the first that is unlikely to gain
    `required_nats` of penalised log-likelihood on the whole take, or whose promised gain is less than `likely_share`
    of the best one's.  Initial states start from those of `fit`.
    """
    whole, likely_share = list[Fit](), SEARCH_LIMITS.likely_share
    credible = [s for s in sized if not effects_at_bounds(s.fit, take)][: SEARCH_LIMITS.max_finalists]
    for s in credible:
        required = likely_share * required_nats * len(s.fit.per_segment) / take.segments
        likely = s.promise + SEARCH_LIMITS.likely_sd * s.sd
        if likely < required or (whole and s.promise < likely_share * credible[0].promise):
            break
        more = fit.hypothesis.with_effects(*s.fit.hypothesis.effects)
        whole += map_converged(refit, [(take, more, s.fit.phi, fit.start, fit.scales)])
    return whole


def _spread_segments(take: Take, count: int) -> Ints:
    """Indices of `count` segments spread evenly over the take, or of all its segments where there are fewer."""
    return np.unique(np.linspace(0, take.segments - 1, min(count, take.segments)).round().astype(np.int64))

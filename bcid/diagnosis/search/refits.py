"""Joint refits with one effect more, or fewer: from the score test, or from large sizes."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.search.screen import CandidateEffect, sharpen_places
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.entry import Effect, Parameter
from bcid.effects.table import EFFECTS, ENTRIES, effect_ids
from bcid.likelihood.divergence import map_converged, none_if_diverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.linearised_segments import (
    LinearisedSegments,
    linearise_with_pushes,
    linearise_without_pushes,
    log_likelihood_along,
)
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.refit_state import Effort
from bcid.likelihood.score_test import replace_value
from bcid.likelihood.take import Take

QUICK = Effort(tangents=4, iterations=6)
"""Where starts are compared on a part of a take, and of refits along one tangent."""

ABSORBED_BY_BASE_MODEL = (
    "motor_dead_zone", "motor_power_limit", "tyre_relaxation", "motor_lag", "steering_lag", "friction_circle",
)  # fmt: skip
"""Effects that a refitted base model takes up so far that no score test beside it shows them."""

NEAR_FIT, NEAR_PUBLISHED = 1.0, 1.6
"""Multiples of their declared sizes from which those effects are refitted: beside the fit, and beside what was known
before it, a published simulation or the nominal car."""

MULTIPLES_BESIDE_SIMULATION = (1.0, 4.0)
"""Multiples of its declared size at which an effect is tried beside a simulation as it is given."""

FAR = Effort(tangents=12, iterations=10)
"""Where a start is far from any maximum."""

PART_STRIDE, LEAST_PART_SEGMENTS = 4, 10
"""Refits from large sizes are compared on every so many segments, but on so many at least where a take has them."""

WHOLE_REFITS = 2
"""So many of the effects that are tried beside a simulation as it is given are refitted on the whole take."""


def gain_nats(fit: Fit, over: Fit) -> float:
    """By how much the penalised log-likelihood of `fit` exceeds that of `over`, in nats.

    The penalty is that of BIC: ln(segments) / 2 for each parameter of an effect.
    """
    return fit.penalised_log_likelihood - over.penalised_log_likelihood


def rank_fits(fits: Iterable[Fit]) -> list[Fit]:
    """The fits in order of penalised log-likelihood, largest first.

    It is log-likelihood plus log prior less ln(segments) / 2 for each effect parameter, as in BIC.
    """
    return sorted(fits, key=lambda f: -f.penalised_log_likelihood)


def rank_credible_fits(fits: Iterable[Fit], take: Take) -> list[Fit]:
    """The fits by penalised log-likelihood, best first, without those with a named effect at a bound of its size."""
    return rank_fits(f for f in fits if not effects_at_bounds(f, take))


def refit_from_large_sizes(fit: Fit, take: Take, excluded: Sequence[str]) -> list[Fit]:
    """The joint refit with the best of the effects in ABSORBED_BY_BASE_MODEL, in a list.

    It is empty where all diverge or end at a bound of the effect's size.
    Refitted base parameters imitate these effects, as a weak motor does a dead zone, so that no score test near `fit`
    shows them.
    """
    starts, h = [], fit.hypothesis
    published = h.prior(h.phi_of(h.nominal, list(h.effect_values(fit.phi).values()))).centre
    for name, (size, near) in itertools.product(
        ABSORBED_BY_BASE_MODEL, ((NEAR_FIT, fit.phi), (NEAR_PUBLISHED, published))
    ):
        if name in h.entries and name not in h.effects and name not in excluded:
            starts.append(h.add_effect(name, near, [size * p.size for p in h.entries[name].parameters]))
    return _refit_likeliest(fit, take, starts, 1)


def refit_from_simulation(given: Fit, corrected: Fit, take: Take, excluded: Sequence[str]) -> list[Fit]:
    """Joint refits of the `corrected` base model from a simulation as it is `given`, each with an effect more.

    Refitted base parameters take up much of what a car has beyond its simulation.  Beside the simulation itself the
    scale of the pushes grows with what is missing, and takes it up, so that a score test shows little of it there, too.
    Hence effects are tried at large sizes, that scale is found anew beside each, and those that then make the take
    likeliest are refitted.  Where pushes make up for what is missing, what is there would be there twice, and poses of
    a tenth of a millimetre forbid it: effects are tried without these pushes, too.  Each segment of a refit begins
    without its pushes where that is better.
    """
    h, untried = corrected.hypothesis, (*excluded, *corrected.hypothesis.effects)
    phi = h.phi_at(given.car(), h.effect_values(corrected.phi) | given.hypothesis.effect_values(given.phi))
    tried = list[tuple[str, list[float]]]()
    for at in (linearise_with_pushes(given), linearise_without_pushes(given, take)):
        likeliest = _effects_beside_simulation(given, take, at, untried)[: SEARCH_LIMITS.max_candidates]
        tried += [start for start in likeliest if start not in tried]
    return _refit_likeliest(given, take, [h.add_effect(name, phi, values) for name, values in tried], WHOLE_REFITS)


def _refit_likeliest(fit: Fit, take: Take, starts: Iterable[tuple[Hypothesis, Floats]], most: int) -> list[Fit]:
    """The refits that are likeliest of those from `starts` (hypotheses and their phi), `most` at most, best first.

    They are compared by refits on a part of the segments, at a quarter of the work where there are many, and begin with
    the initial states and scales of `fit`.  A part says so much less against what a simulation is trusted for.  Those
    with an effect at a bound of its size, and those that diverge, are left out.
    """
    stride = max(1, min(PART_STRIDE, take.segments // LEAST_PART_SEGMENTS))
    chosen, far = np.arange(0, take.segments, stride), partial(refit, effort=FAR)
    part = take.part(chosen)
    share = part.segments / take.segments
    compared = map_converged(
        far, [(part, h.scale_simulation_prior(share), phi, fit.start[chosen], fit.scales) for h, phi in starts]
    )
    best = rank_credible_fits(compared, part)[:most]
    ends = [(take, f.hypothesis.scale_simulation_prior(1.0), f.phi, fit.start, fit.scales) for f in best]
    return rank_credible_fits(map_converged(refit, ends), take)


def _effects_beside_simulation(
    given: Fit, take: Take, at: LinearisedSegments, excluded: Sequence[str]
) -> list[tuple[str, list[float]]]:
    """All effects without a place, with the values of those tried that make a take likeliest, likeliest first."""
    h, found = given.hypothesis, dict[str, tuple[float, list[float]]]()
    for name in (n for n in h.entries if n in EFFECTS and n not in excluded):
        for values in _sizes_beside_simulation(h.entries[name]):
            more, phi = h.add_effect(name, given.phi, values)
            nats = none_if_diverged(log_likelihood_along, at, take, more, phi)
            if nats is not None and (name not in found or nats > found[name][0]):
                found[name] = nats, values
    return [(name, found[name][1]) for name in sorted(found, key=lambda name: -found[name][0])]


def _sizes_beside_simulation(effect: Effect) -> Iterator[list[float]]:
    """Parameters (SI) of an effect, one after the other at large and usual sizes, either way, within its bounds.

    There are none of an effect with a place, of which there would be too many.
    """
    if effect.place_parameters:
        return
    off = [p.off for p in effect.parameters]
    for (i, p), multiple, sign in itertools.product(
        enumerate(effect.parameters), MULTIPLES_BESIDE_SIMULATION, (1.0, -1.0)
    ):
        value = float(np.clip(sign * multiple * p.size, p.low, p.high))
        if value != p.off:
            yield replace_value(off, i, value)


def refit_along_tangent(fit: Fit, take: Take, candidate: CandidateEffect) -> Fit:
    """Quick joint refit of `fit` with the candidate effect added: a few Gauss-Newton steps.

    Derivatives of the predictions by base parameters and initial states stay those of `fit`.  The effect starts at the
    values that the score test found, its place or time first moved to where the test promises most.
    """
    sharp = sharpen_places(fit, take, candidate)
    more, phi = fit.hypothesis.add_effect(candidate.effect, fit.phi, sharp.values)
    return refit(take, more, phi, fit.start, fit.scales, QUICK, fit.tangent)


def refit_candidates_along_tangent(fit: Fit, take: Take, candidates: Iterable[CandidateEffect]) -> list[Fit]:
    """The quick refits of `refit_along_tangent` with each of the `candidates`, less those that diverge."""
    return list(map_converged(refit_along_tangent, [(fit, take, candidate) for candidate in candidates]))


def refit_fully(fit: Fit, take: Take) -> Fit:
    """The hypothesis of `fit` refitted from it, with derivatives renewed as parameters move; `fit` if that diverges."""
    return none_if_diverged(refit, take, fit.hypothesis, fit.phi, fit.start, fit.scales) or fit


def refit_with_effects(fit: Fit, take: Take, effects: tuple[str, ...], added: Sequence[float] = ()) -> Fit:
    """The joint refit that holds exactly these `effects` (of the table, or corrections), beside those that are assumed.

    Parameters of effects that `fit` holds start from its values, those of new ones, last in `effects`, from `added`
    (SI).

    Raises:
        PredictionDiverged: predictions diverge from every start.
    """
    less = fit.hypothesis.with_effects(*effects)
    old = fit.hypothesis.effect_values(fit.phi)
    known = [old[f] for f, _ in less.effect_parameters if f in old]
    # without an effect the fitted car may diverge: the nominal car is another start
    starts = [
        (take, less, less.phi_of(car, [*known, *added]), start, fit.scales)
        for car, start in ((fit.car(), fit.start), (less.nominal, take.start))
    ]
    return next(map_converged(refit, starts, required=True))


def named_effects(fit: Fit) -> tuple[str, ...]:
    """Ids of the effects in the table of 41 (EFFECTS) that `fit` holds beyond those its base model assumes."""
    return tuple(n for n in fit.hypothesis.effects if n in EFFECTS and n not in fit.hypothesis.assumed)


def fitted_corrections(fit: Fit) -> tuple[str, ...]:
    """Ids of the corrections of the base model's simplifications that `fit` holds and its base model does not assume.

    They are those in the table CORRECTIONS.
    """
    return tuple(n for n in fit.hypothesis.effects if n in CORRECTIONS and n not in fit.hypothesis.assumed)


def estimates_by_symbol(fit: Fit, name: str) -> dict[str, tuple[float, float]]:
    """Value and standard error (SI units) of each parameter of one effect or correction in a fit, by its symbol."""
    estimates, entry = fit.effect_estimates(), ENTRIES[name]
    return {p.symbol: estimates[f] for f, p in zip(entry.fields, entry.parameters, strict=True)}


def first_order_nats(fit: Fit, name: str) -> float:
    """Nats that an effect of a `fit` adds to first order: half the square of its size over its standard error.

    It is that of the parameter which adds most; places and times are no sizes.
    """
    estimates, entry = estimates_by_symbol(fit, name), ENTRIES[name]
    sizes = [(estimates[p.symbol], p.off) for p in entry.parameters if not p.is_place]
    return max(0.5 * ((value - off) / se) ** 2 if se > 0.0 else np.inf for (value, se), off in sizes)


def effects_at_bounds(fit: Fit, take: Take) -> tuple[str, ...]:
    """Ids of the named effects of `fit` with an implausible size: a signed amplitude that ended at a bound.

    Included are changes before or after which there are fewer segments than a recording needs to be judged at all: they
    stand for whatever is particular to those few, or make up for wrong base parameters.
    """
    values = fit.hypothesis.effect_values(fit.phi)

    def is_at_bound(field: str, p: Parameter) -> bool:
        """Whether one parameter of the fit ended at a bound, or a time near an end of the take."""
        if p.symbol == "t_s":
            before = int((take.begin_s - take.zero_s < values[field]).sum())
            return min(before, take.segments - before) < LIKELIHOOD_LIMITS.min_segments
        return p.low < 0.0 and not p.is_place and p.is_at_bound(values[field])

    at_bounds = effect_ids(field for field, p in fit.hypothesis.effect_parameters if is_at_bound(field, p))
    return tuple(name for name in named_effects(fit) if name in at_bounds)

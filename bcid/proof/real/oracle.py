"""Which questions have an answer: what the withheld physics is worth on a drive, and what could stand in its place.

A drive shows an effect if, with its size free, it makes the drive likelier by more than what chance reaches; no
diagnosis could name it otherwise.  And a name that makes the drive as likely in its place, and leaves little of it to
be found, is as right an answer.  Both are found by refits from several starts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from bcid.diagnosis.judge.verdict import are_indistinguishable
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.screen import CandidateEffect, screen_effects, simulate_trials
from bcid.effects.table import EFFECTS
from bcid.likelihood.divergence import map_converged, none_if_diverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take
from bcid.proof.real.limits import LIMITS


class TrueStructure(NamedTuple):
    """A drive with and without what is withheld, both refitted."""

    fit: Fit  # of the simulation with what is withheld, its size free
    without: Fit

    @property
    def nats(self) -> float:
        """What the withheld physics is worth: penalised log-likelihood with it less that without it."""
        return refits.gain_nats(self.fit, self.without)


def fit_true_structure(
    without: Fit, structure: Hypothesis, take: Take, effects: Sequence[str], sizes: Mapping[str, float],
    whole: Fit | None = None,
) -> TrueStructure:  # fmt: skip
    """Refit a drive with and without the `effects` that were withheld from its simulation; the effects' sizes are free.

    With them it is refitted from the fit `without` them, the effects off and at their published `sizes` (SI, by
    field), and from the fit of the `whole` simulation, or where there is none from the simulation's own car with these
    sizes, as the fit without them is of a car that they have pulled away.  Without them also from the best of these, so
    that neither is less likely for where its refit began.

    Args:
        without: fit of the simulation without the effects.
        structure: the simulation's hypothesis without the effects; it is that of `without` unless the question
            changes parameters besides.
        take: the drive.
        effects: ids of the effects.
        sizes: their published parameters.
        whole: fit of the simulation with the effects, if it has them.

    Raises:
        PredictionDiverged: predictions with the effects diverge from every start.
    """
    more = structure.with_effects(*structure.effects, *effects)
    off, known = _values_of(without), {**_values_of(without), **sizes}
    starts = [
        (take, more, more.phi_at(without.car(), off), without.start, without.scales),
        (take, more, more.phi_at(without.car(), known), without.start, without.scales),
    ]
    if whole is None:
        starts.append((take, more, more.phi_at(structure.nominal, known), take.start, without.scales))
    else:
        start = whole.start if len(whole.start) == take.segments else take.start
        starts.append((take, more, more.phi_at(whole.car(), _values_of(whole)), start, whole.scales))
    best = refits.rank_fits(map_converged(refit, starts, required=True))[0]
    less = without.hypothesis
    back = none_if_diverged(refit, take, less, less.phi_at(best.car(), _values_of(best)), best.start, best.scales)
    return TrueStructure(best, refits.rank_fits([without, *([back] if back else [])])[0])


def find_equivalents(
    true: TrueStructure, take: Take, effects: Sequence[str], answered: Mapping[str, Mapping[str, float]], gate: float
) -> dict[str, float]:
    """Names that the drive cannot tell from the withheld `effects`, and by how many nats each is less likely.

    Each is refitted in their place; `are_indistinguishable` decides, as it does of a verdict's rivals.  Beside it they
    must be worth no more than the `gate` (nats), or half of what they are worth alone if that is more: what makes the
    drive as likely but leaves them to be found is something else.  Tried are the names of the answer (`answered`, with
    values by field where it has any) and, of the others, those that a score test promises most of.  A name whose size
    ends at a bound is none.
    """
    less = true.fit.hypothesis.with_effects(*(e for e in true.fit.hypothesis.effects if e not in effects))
    without = _refit_without(true, less, take)
    if without is None:
        return {}
    tried = {e: v for e, v in answered.items() if e in less.entries and e not in (*effects, *less.effects)}
    trials = simulate_trials(without, take).without((*effects, *less.effects))
    scored = {c.effect: c for c in screen_effects(without, take, trials) if c.effect in EFFECTS}
    others = [name for name in scored if name not in tried][: LIMITS.max_equivalents_tried]
    found = dict[str, float]()
    for name in (*tried, *others):
        fits = _refit_in_place(name, scored.get(name), tried.get(name, {}), true, without, take)
        best = next(iter(refits.rank_credible_fits(fits, take)), None)
        if best is None or not are_indistinguishable(true.fit, best, take):
            continue
        if _worth_beside(best, true, effects, take) <= max(gate, LIMITS.max_share_left * true.nats):
            found[name] = round(refits.gain_nats(true.fit, best), 1)
    return dict(sorted(found.items(), key=lambda pair: pair[1]))


def _refit_without(true: TrueStructure, less: Hypothesis, take: Take) -> Fit | None:
    """The fit without what is withheld, of the true structure's own parameters; None if it diverges."""
    if true.without.hypothesis == less:
        return true.without
    starts = [
        (take, less, less.phi_at(fit.car(), _values_of(fit)), fit.start, fit.scales) for fit in (true.without, true.fit)
    ]
    return next(iter(refits.rank_fits(map_converged(refit, starts))), None)


def _refit_in_place(
    name: str, candidate: CandidateEffect | None, values: Mapping[str, float], true: TrueStructure, without: Fit,
    take: Take,
) -> Iterable[Fit]:  # fmt: skip
    """Refits with the effect `name` in place of what is withheld, less those that diverge.

    They begin beside the fit `without` it where the score test puts it (`candidate`), and beside the true structure's
    car with the answer's own `values`, by field, or the candidate's.
    """
    quick = none_if_diverged(refits.refit_along_tangent, without, take, candidate) if candidate else None
    if quick is not None:
        yield refits.refit_fully(quick, take)
    more = without.hypothesis.with_effects(*without.hypothesis.effects, name)
    entry = more.entries[name]
    own = dict(values) or (dict(zip(entry.fields, candidate.values, strict=True)) if candidate else {})
    if own:
        phi = more.phi_at(true.fit.car(), {**_values_of(true.fit), **own})
        yield from map_converged(refit, [(take, more, phi, true.fit.start, true.fit.scales)])


def _worth_beside(name: Fit, true: TrueStructure, effects: Sequence[str], take: Take) -> float:
    """Nats that what is withheld, the `effects`, adds beside a fit with a `name` in its place; infinity if all diverge.

    By so much both together exceed the likelier of the two.
    """
    more = name.hypothesis.with_effects(*name.hypothesis.effects, *effects)
    starts = [
        (take, more, more.phi_at(near.car(), _values_of(true.fit) | _values_of(name)), near.start, near.scales)
        for near in (name, true.fit)
    ]
    both = next(iter(refits.rank_fits(map_converged(refit, starts))), None)
    return refits.gain_nats(both, refits.rank_fits([name, true.fit])[0]) if both else math.inf


def _values_of(fit: Fit) -> dict[str, float]:
    """Parameters (SI) of a fit's effects by field."""
    return fit.hypothesis.effect_values(fit.phi)

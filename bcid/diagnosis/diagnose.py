"""The diagnosis of recordings step by step: fit the base model, name what is missing, locate it, judge."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.aliases import Progress
from bcid.diagnosis.judge.not_excited import Excitation, measure_excitation
from bcid.diagnosis.judge.other_figures import ChangedFigure, find_other_figures
from bcid.diagnosis.judge.verdict import Judgement, judge_names
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.diagnosis.locate.mismatch import Location, locate_mismatch
from bcid.diagnosis.locate.pushes import Disturbances, estimate_disturbances
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.remainder.curve import MissingLaw, change_by_names, missing_laws
from bcid.diagnosis.remainder.evidence import SPREADS
from bcid.diagnosis.remainder.explain import Explained, explain_with_copies
from bcid.diagnosis.search.name_search import Naming, name_effects
from bcid.diagnosis.search.refits import named_effects
from bcid.documents.diagnosis import NotExcited
from bcid.effects.corrections import MEASURED_SPEED, RAW_COMMANDS
from bcid.effects.entry import VehicleScale
from bcid.effects.table import ENTRIES, effect_ids
from bcid.estimate.types import Estimate
from bcid.likelihood import prepare
from bcid.likelihood.divergence import none_if_diverged, refuse_divergence
from bcid.likelihood.refit import Fit, evaluate_fixed
from bcid.likelihood.take import Take
from bcid.models.newton_euler.initial_guess import guess_car
from bcid.recording.checks.contacts import Contact
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


@dataclass(frozen=True)
class Diagnosis:
    """What recordings show beside the base model, and the take and the fits that show it."""

    take: Take
    contacts: tuple[Contact, ...]
    naming: Naming
    judgement: Judgement
    location: Location
    laws: Mapping[str, MissingLaw]  # before any hypothesis, by the channels that stand out and have one
    pushes_before: Disturbances  # under the refitted base model
    pushes_after: Disturbances  # under the fit with the named effects
    excitation: Excitation
    other_figures: tuple[ChangedFigure, ...] = ()  # of the simulation, which are others here

    @property
    def not_excited(self) -> tuple[NotExcited, ...]:
        """The effects that the drive would have shown only if unusually large."""
        return self.excitation.not_excited

    @property
    def fit(self) -> Fit:
        """The fit with the named effects; the corrected base model where there is none."""
        return self.naming.best

    @property
    def whole_fit(self) -> Fit:
        """The fit with the named effects and, where it is more than chance, what has no name."""
        return self.naming.rest.fit if self.naming.unknown_nats > 0.0 else self.naming.best

    @property
    def p_value(self) -> float:
        """The p-value of nothing missing (Bonferroni): 4 min(p of a remainder, of places, times, corrections).

        A take is exp(x) times likelier with a remainder by chance in a share exp(-x) of takes of nothing at most
        (Markov's inequality), for each of the spreads from which those of its channels were chosen.  Where nothing has
        a name, chance may have been drawn for the take, too, and the larger p-value counts.
        """
        from scipy.stats import chi2

        base, corrected, location = self.naming.base, self.naming.corrected, self.location
        free = len(corrected.hypothesis.effect_parameters) - len(base.hypothesis.effect_parameters)
        gained = corrected.log_likelihood - base.log_likelihood
        corrections = float(chi2.sf(2.0 * gained, free)) if free else 1.0
        before = self.naming.before
        choices = sum(tau > 0.0 for tau in before.spread.values()) * np.log(len(SPREADS) - 1)
        remainder = float(np.exp(-max(before.nats - choices, 0.0)))
        if self.naming.chance and not self.naming.gains:
            remainder = max(remainder, self.naming.chance.p_value(before.nats))
        smallest = min(remainder, location.place_p_value, location.window_p_value, corrections)
        return min(1.0, 4.0 * max(smallest, JUDGE_LIMITS.min_p_value))


class BaseFit(NamedTuple):
    """A take and the base model refitted to it."""

    take: Take
    contacts: tuple[Contact, ...]
    fit: Fit
    full_speed_units: VehicleScale  # of the vehicle at the largest speed that can be commanded
    reference: ReferenceModel | None = None
    others: tuple[Fit, ...] = ()  # fits of the base model that ended in other basins

    def evaluate_reference(self) -> Fit | None:
        """The reference model as given, with nothing refitted; None if there is none, or it diverges."""
        if self.reference is None:
            return None
        h = self.fit.hypothesis
        values = [self.reference.effects.get(field, 0.0) for field, _ in h.effect_parameters]
        phi = h.phi_of(self.reference.car, values)
        return none_if_diverged(evaluate_fixed, self.take, h, phi, self.fit.scales)


def diagnose_recordings(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle,
    reference: ReferenceModel | None = None, progress: Progress = lambda share, text: None,
    excluded: Sequence[str] = (),
) -> Diagnosis:  # fmt: skip
    """Diagnose recordings of one vehicle: locate what a base model leaves unexplained, and name the effects behind it.

    The base model is the Newton-Euler model, or `reference`, refitted.  How a name is given: docs/method.md.

    `progress` is called with the share done and a text; effects with an id in `excluded` are not considered.

    Raises:
        InputRefused: too little of the recordings can be used, or no model can follow them.
    """
    base = fit_base_model(recordings, estimates, vehicle, reference, progress)
    take, fit = base.take, base.fit
    with threadpool_limits(1, "blas"), refuse_divergence(recordings):
        naming = name_effects(
            fit, take, excluded, base.others, base.evaluate_reference(), lambda text: progress(0.3, text)
        )
        progress(0.8, "what is left")
        before = estimate_disturbances(naming.corrected, take)
        seen = explain_with_copies(naming.corrected, take, naming.before.seen.basis)
        location = locate_mismatch(seen.channel_nats(), seen.depends_on, before, fit.hypothesis.units)
        laws = draw_laws(naming, take, location, seen)
        judgement = judge_names(naming, take)
        after = estimate_disturbances(naming.best, take)
        excitation = measure_excitation(naming.best, take, base.full_speed_units, naming.gate_of)
        figures = find_other_figures(naming.best, naming.rest.fit, naming.nulls.gate)
    return Diagnosis(take, base.contacts, naming, judgement, location, laws, before, after, excitation, figures)


def draw_laws(naming: Naming, take: Take, location: Location, seen: Explained) -> dict[str, MissingLaw]:
    """The missing law in each channel where free functions explain more than chance, beside the corrected base model.

    `seen` is what they explain.  Over it, what the named effects alone would have shown.
    """
    outstanding = [channel for channel, nats in location.channel_nats.items() if nats > naming.nulls.gate]
    named = bool(outstanding and named_effects(naming.best))
    change = change_by_names(naming.corrected, naming.best, take) if named else None
    return missing_laws(naming.corrected, take, seen, outstanding, change)


def fit_base_model(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle,
    reference: ReferenceModel | None = None, progress: Progress = lambda share, text: None,
) -> BaseFit:  # fmt: skip
    """Refit the Newton-Euler model, or the `reference` model with its effects, to the recordings.

    The result also holds the take (the recordings cut into 1.5 s segments, each predicted from its own initial state),
    the bumps and crashes found, which are left out of it, and the vehicle's mass, length and time at full speed over
    those of the bumper car.

    Raises:
        InputRefused: too little of the recordings can be used, or the model cannot follow them.
    """
    progress(0.02, "a first car")
    T_s, d = estimates[0].steering_constants()
    car = reference.car if reference else guess_car(estimates, vehicle, T_s, d)._replace(u_0=0.0)
    assumed = dict(reference.effects) if reference else {}
    # the gain of raw commands belongs to the base model, and so does when a measured wheel speed was logged
    own = (RAW_COMMANDS if vehicle.has_raw_steering else ()) + (MEASURED_SPEED if car.follows_wheel > 0.0 else ())
    assumed = {field: 0.0 for name in own for field in ENTRIES[name].fields} | assumed
    hypothesis = prepare.base_hypothesis(vehicle, car, estimates, effect_ids(assumed))
    values = list(assumed.values())
    if reference:
        hypothesis = replace(hypothesis, known=reference.known)
    if reference and reference.relative_sd is not None:
        hypothesis = hypothesis.trust_simulation(values, reference.relative_sd, reference.relative_sd_of)
    if reference and reference.begin:
        hypothesis = hypothesis.begin_at(reference.begin)
    progress(0.05, "the base model")
    with threadpool_limits(1, "blas"), refuse_divergence(recordings):
        take, contacts, (fit, others) = prepare.prepare_and_fit_base(recordings, estimates, hypothesis, values)
    units = prepare.scale_at_driven_speed(fit.car(), estimates, vehicle.motor.reference_speed_mps or 0.0)
    return BaseFit(take, contacts, fit, units, reference, others)

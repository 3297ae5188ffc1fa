"""The diagnosis of recordings step by step: fit the base model, locate the mismatch, search, judge."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.aliases import Progress
from bcid.diagnosis.judge.not_excited import find_unexcited_effects
from bcid.diagnosis.judge.verdict import Judgement, judge_search
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.diagnosis.locate.mismatch import Location, locate_mismatch
from bcid.diagnosis.locate.pushes import Disturbances, estimate_disturbances
from bcid.diagnosis.locate.regression import regress_disturbances
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.search.forward_backward import SearchResult, search_effects
from bcid.documents.diagnosis import NotExcited
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.entry import VehicleScale
from bcid.effects.table import ENTRIES, effect_ids
from bcid.errors import PredictionDiverged
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
    search: SearchResult
    judgement: Judgement
    location: Location
    pushes_before: Disturbances  # under the refitted base model
    pushes_after: Disturbances  # under the fit with the named effects
    not_excited: tuple[NotExcited, ...]

    @property
    def p_value(self) -> float:
        """The p-value of nothing missing (Bonferroni): 4 min(p of effects, of places, of times, of corrections)."""
        from scipy.stats import chi2

        base, corrected, location = self.search.base, self.search.corrected, self.location
        free = len(corrected.hypothesis.effect_parameters) - len(base.hypothesis.effect_parameters)
        gained = corrected.log_likelihood - base.log_likelihood
        corrections = float(chi2.sf(2.0 * gained, free)) if free else 1.0
        smallest = min(self.search.p_value, location.place_p_value, location.window_p_value, corrections)
        return min(1.0, 4.0 * max(smallest, JUDGE_LIMITS.min_p_value))


class BaseFit(NamedTuple):
    """A take and the base model refitted to it."""

    take: Take
    contacts: tuple[Contact, ...]
    fit: Fit
    full_speed_units: VehicleScale  # of the vehicle at the largest speed that can be commanded
    reference: ReferenceModel | None = None

    def evaluate_reference(self) -> Fit | None:
        """The reference model as given, with nothing refitted; None if there is none, it is trusted, or it diverges."""
        if self.reference is None or self.reference.relative_sd is not None:
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

    The base model is the Newton-Euler model, or `reference`, refitted.  Its pose predictions are linearised about
    motions without pushes (disturbance forces and moments on the body, constant over 0.5 s).  Where the predictions are
    too nonlinear for that (`needs_pushes`), even with the named effects, the diagnosis is repeated with predictions
    linearised about motions under the most likely pushes, at several times the work; effects that the first search
    dropped as proxies (they only stood in for something without a name) are excluded from the second.  A `reference`
    with a prior (`relative_sd`) whose predictions are too nonlinear is diagnosed under pushes at once.

    `progress` is called with the share done and a text; effects with an id in `excluded` are not considered.

    Raises:
        InputRefused: too little of the recordings can be used, or no model can follow them.
    """
    base = fit_base_model(recordings, estimates, vehicle, reference, progress)
    proxies: tuple[str, ...] = ()
    with threadpool_limits(1, "blas"), refuse_divergence(recordings):
        if base.fit.hypothesis.trusted_simulation is None or not prepare.needs_pushes(base.fit, base.take):
            # a search that diverges without pushes may not diverge under them
            with suppress(PredictionDiverged, np.linalg.LinAlgError):
                diagnosis = _diagnose_take(base, progress, excluded)
                if not prepare.needs_pushes(diagnosis.judgement.fit, base.take):
                    return diagnosis
                proxies = diagnosis.judgement.search.proxies
        progress(0.05, "the base model, under pushes")
        take, fit = prepare.refit_base_with_pushes(base.take, base.fit)
        return _diagnose_take(base._replace(take=take, fit=fit), progress, excluded, proxies)


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
    # the gain of raw commands belongs to the base model
    if vehicle.has_raw_steering:
        assumed = {field: 0.0 for name in RAW_COMMANDS for field in ENTRIES[name].fields} | assumed
    hypothesis = prepare.base_hypothesis(vehicle, car, estimates, effect_ids(assumed))
    values = list(assumed.values())
    if reference and reference.relative_sd is not None:
        hypothesis = hypothesis.trust_simulation(values, reference.relative_sd, reference.relative_sd_of)
    progress(0.05, "the base model")
    with threadpool_limits(1, "blas"), refuse_divergence(recordings):
        take, contacts, fit = prepare.prepare_and_fit_base(recordings, estimates, hypothesis, values)
    units = prepare.scale_at_driven_speed(fit.car(), estimates, vehicle.motor.reference_speed_mps or 0.0)
    return BaseFit(take, contacts, fit, units, reference)


def _diagnose_take(
    base: BaseFit, progress: Progress, excluded: Sequence[str], dropped: tuple[str, ...] = ()
) -> Diagnosis:
    """Locate what a base model's fit leaves unexplained, search the effects that explain it, and judge them.

    Effects with an id in `excluded` are not considered; nor are those in `dropped`, proxies of an earlier search (they
    only stood in for something without a name), which are reported as dropped.
    """
    take, fit = base.take, base.fit
    progress(0.15, "where the mismatch is")
    pushes = estimate_disturbances(fit, take)
    regression = regress_disturbances(pushes, fit.car())
    location = locate_mismatch(fit, take, pushes, regression)
    search = search_effects(
        fit, take, regression, lambda text: progress(0.3, text), (*excluded, *dropped), base.evaluate_reference()
    )
    progress(0.8, "what is left")
    judgement = judge_search(search, take, location.place, location.remaining if search.best is fit else None, dropped)
    pushes_after = estimate_disturbances(judgement.fit, take)
    not_excited = find_unexcited_effects(judgement.fit, take, base.full_speed_units, search.nulls.gate)
    return Diagnosis(take, base.contacts, search, judgement, location, pushes, pushes_after, not_excited)

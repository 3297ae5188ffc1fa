"""A diagnosis from a recording and its estimate: everything in order, nothing of it on disk."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.aliases import Progress
from bcid.diagnosis.compared import Compared
from bcid.diagnosis.judge.not_excited import Unexcited, unexcited
from bcid.diagnosis.judge.verdict import Judgement, judged
from bcid.diagnosis.locate.location import Location, located
from bcid.diagnosis.locate.pushes import Disturbances, disturbances
from bcid.diagnosis.locate.regression import remainder
from bcid.diagnosis.search.forward_backward import Search, search
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.entry import Units
from bcid.effects.table import ENTRIES, effects_of
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.likelihood.prepare import base_from, base_of, too_bent, under_pushes, units_of
from bcid.likelihood.refit import Fit, held
from bcid.likelihood.take import Take
from bcid.models.newton_euler.initial_guess import started_car
from bcid.recording.checks.contacts import Contact
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

SMALLEST_P = 1e-3  # that is claimed: the null takes drawn are about a thousand


@dataclass(frozen=True)
class Diagnosis:
    """What was found, and what it was found with."""

    take: Take
    contacts: tuple[Contact, ...]
    search: Search
    judgement: Judgement
    location: Location
    before: Disturbances  # under the refitted base model
    after: Disturbances  # under the fit with what was found
    unexcited: tuple[Unexcited, ...]

    @property
    def p_value(self) -> float:
        """That nothing is missing: of all effects, places, times and the base model's simplifications (Bonferroni)."""
        from scipy.stats import chi2

        found, location = self.search, self.location
        free = len(found.corrected.hypothesis.parameters) - len(found.base.hypothesis.parameters)
        gained = found.corrected.log_likelihood - found.base.log_likelihood
        simplified = float(chi2.sf(2.0 * gained, free)) if free else 1.0
        smallest = min(found.p_value, location.place_p, location.window_p, simplified)
        return min(1.0, 4.0 * max(smallest, SMALLEST_P))


class Based(NamedTuple):
    """A take and the base model refitted to it."""

    take: Take
    contacts: tuple[Contact, ...]
    fit: Fit
    usual: Units  # of the vehicle as fast as it can be asked to drive
    simulation: Compared | None = None

    def given(self) -> Fit | None:
        """The simulation as it is; none where it is trusted, so that the fit has it, or does not drive this take."""
        if self.simulation is None or self.simulation.trust is not None:
            return None
        h = self.fit.hypothesis
        values = [self.simulation.effects.get(field, 0.0) for field, _ in h.parameters]
        try:
            return held(self.take, h, h.start(self.simulation.car, values), self.fit.scales)
        except FloatingPointError:
            return None

    def under_pushes(self) -> Based:
        """The same with all predictions made under the likeliest pushes.

        Raises:
            FloatingPointError: when the base model cannot follow it.
        """
        take, fit = under_pushes(self.take, self.fit)
        return self._replace(take=take, fit=fit)


def diagnosed(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle,
    simulation: Compared | None = None, progress: Progress = lambda share, text: None, left_out: Sequence[str] = (),
) -> Diagnosis:  # fmt: skip
    """What the recordings show beside the Newton-Euler model, or beside what `simulation` has.

    The base model is refitted, from the simulation's car where one is given.  Effects in `left_out` are not
    considered.  Where predictions still miss their tangent beside the best that explains them, all is done again
    under the likeliest pushes, at several times the work: what is missing had bent it, and as a rule it is found
    without.  What only stood in for it does not come back then: pushes do the rest of its work, and hide that.
    Beside a simulation that is to be trusted, all of which is hardly ever one effect from right, nothing is looked for
    but under pushes where it misses.

    Raises:
        InputRefused: when too little of the recordings can be used.
    """
    of = based(recordings, estimates, vehicle, simulation, progress)
    dropped: tuple[str, ...] = ()
    with _followed(recordings):
        if of.fit.hypothesis.simulated is None or not too_bent(of.fit, of.take):
            with suppress(FloatingPointError, np.linalg.LinAlgError):  # what no tangent follows pushes may
                found = _of_take(of, progress, left_out)
                if not too_bent(found.judgement.fit, of.take):
                    return found
                dropped = found.judgement.search.stand_ins
        progress(0.05, "the base model, under pushes")
        return _of_take(of.under_pushes(), progress, left_out, dropped)


def based(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle,
    simulation: Compared | None = None, progress: Progress = lambda share, text: None,
) -> Based:  # fmt: skip
    """The base model, or the `simulation`, refitted to the recordings.

    Raises:
        InputRefused: when too little of the recordings can be used.
    """
    facts = estimates[0].facts
    progress(0.02, "a first car")
    car = simulation.car if simulation else started_car(estimates, vehicle, facts["T_s"], facts["d"])._replace(u_0=0.0)
    assumed = dict(simulation.effects) if simulation else {}
    if vehicle.raw_steering:  # its gain belongs to the base model
        assumed = {field: 0.0 for name in RAW_COMMANDS for field in ENTRIES[name].fields} | assumed
    hypothesis = base_of(vehicle, car, estimates, effects_of(assumed))
    values = list(assumed.values())
    if simulation and simulation.trust is not None:
        hypothesis = hypothesis.trusting(values, simulation.trust, simulation.trust_of)
    progress(0.05, "the base model")
    with _followed(recordings):
        take, hits, fit = base_from(recordings, estimates, hypothesis, values)
    usual = units_of(fit.car(), estimates, vehicle.motor.reference_speed_mps or 0.0)
    return Based(take, hits, fit, usual, simulation)


@contextmanager
def _followed(recordings: Sequence[Recording]) -> Iterator[None]:
    """Refuse recordings that no model can follow.  The kernels share the cores: BLAS on small matrices would fight."""
    with threadpool_limits(1, "blas"):
        try:
            yield
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            raise InputRefused(
                recordings[0].sources[0].path,
                "poses and commands",
                f"the model cannot follow them: {error}",
                "check the vehicle file's mass, distances and limits, and the recording's units",
            ) from error


def _of_take(of: Based, progress: Progress, left_out: Sequence[str], dropped: tuple[str, ...] = ()) -> Diagnosis:
    """What a take shows, `dropped` left out as well, and told as such."""
    take, base = of.take, of.fit
    progress(0.15, "where the mismatch is")
    before = disturbances(base, take)
    whole = remainder(before, base.car())
    location = located(base, take, before, whole)
    found = search(base, take, whole, lambda text: progress(0.3, text), (*left_out, *dropped), of.given())
    progress(0.8, "what is left")
    judgement = judged(found, take, location.place, location.left if found.best is base else None, dropped)
    after = disturbances(judgement.fit, take)
    not_seen = unexcited(judgement.fit, take, of.usual, found.nulls.gate)
    return Diagnosis(take, of.contacts, found, judgement, location, before, after, not_seen)

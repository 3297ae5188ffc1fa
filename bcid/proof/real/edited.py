"""Edited recordings: whether an effect that is made in a real drive is found, and as large as it was made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bcid.diagnosis.compared import Compared
from bcid.diagnosis.diagnose import Diagnosis, diagnosed
from bcid.diagnosis.judge.verdict import values_of
from bcid.diagnosis.reference import of_parameters
from bcid.effects.table import effects_of
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.likelihood.refit import refit
from bcid.physics.car import Car
from bcid.proof.real.edits import EDITS
from bcid.proof.real.question_files import Asked
from bcid.proof.real.questions import Edited
from bcid.proof.rows import said
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

AS_IT_WAS = 0.02  # relative trust in what a recording shows without the edit


class Before(NamedTuple):
    """What a drive shows before anything is edited in it."""

    known: Compared  # a simulation of it that is to be trusted
    of: dict[str, dict[str, tuple[float, float]]]  # by effect, of its parameters: values with standard errors

    def row(self) -> dict[str, Any]:
        """As it is kept."""
        return {"car": self.known.car._asdict(), "effects": self.known.effects, "of": self.of}

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> Before:
        """As it was kept."""
        return cls(Compared(Car(**row["car"]), row["effects"], AS_IT_WAS), row["of"])


def as_it_was(name: str, effects: Iterable[str], asked: Asked) -> Before:
    """What a recording shows before any of these effects is edited in it, whether or not it has a name.

    It is asked freely first, and then as the edited one will be, beside what was found: what that adds is no edit's.
    """
    vehicle, start = asked.vehicle_of(name), None
    recording, estimate, _ = asked.moved(name, vehicle)
    if asked.simulation is not None:
        start = of_parameters(asked.simulation, [estimate], vehicle)._replace(trust=None)
    freely = diagnosed([recording], [estimate], vehicle, start)
    unedited = diagnosed([recording], [estimate], vehicle, _trusted(freely))
    found = Before(_trusted(unedited), {})
    for effect in effects:
        with suppress(FloatingPointError):  # that is of this edit alone
            found.of[effect] = _before(effect, unedited)
    return found


def _trusted(found: Diagnosis) -> Compared:
    """What a drive showed, as a simulation of it that is to be trusted."""
    return Compared.of(found.search.best)._replace(trust=AS_IT_WAS)


def answered(case: Edited, unedited: Before, asked: Asked) -> dict[str, Any]:
    """What is made of an edited recording, of which all else is known; the effect itself is looked for anew.

    And what of its parameters the drive showed `before`, with standard errors.

    Raises:
        FloatingPointError: where the drive, edited or not, cannot be followed.
    """
    if case.effect not in unedited.of:
        raise FloatingPointError(f"what the drive shows of {case.effect} before it is edited leaves the finite numbers")
    known = unedited.known
    changed, estimate, vehicle = _changed(case, known, asked)
    found = diagnosed([changed], [estimate], vehicle, known.without(case.effect))
    return {"truth": case.value, "before": unedited.of[case.effect], **said(found)}


def _changed(case: Edited, known: Compared, asked: Asked) -> tuple[Recording, Estimate, Vehicle]:
    """The edited recording and its motion, and the vehicle with a lock that does not cut the edit off."""
    vehicle = asked.vehicle_of(case.recording)
    recording, _, tuning = asked.moved(case.recording, vehicle)
    # an offset is the wheel's, and the log's by as much less as the drive shows that a logged angle moves the wheel
    gain = 1.0 + known.effects.get("steering_scale__g", 0.0) if case.effect == "steering_offset" else 1.0
    changed = EDITS[case.effect](recording, case.value / gain)
    reach = float(np.nanmax(np.abs(changed.commands.values[:, 0])))
    lock = {"max_angle_rad": max(vehicle.steering.max_angle_rad, reach)}
    vehicle = vehicle.model_copy(update={"steering": vehicle.steering.model_copy(update=lock)})
    return changed, estimate_motion(changed, vehicle, tuning), vehicle


def _before(effect: str, unedited: Diagnosis) -> dict[str, tuple[float, float]]:
    """What an unedited drive shows of an effect's parameters beside all else that it shows, with standard errors.

    The effect's own are as free as they are in an edited drive, from where they were found or from nothing.  As much
    as nothing where an effect is of one sign only and the drive would rather have the other.
    """
    best = unedited.search.best
    values, entry = best.hypothesis.values(best.phi), best.hypothesis.entries[effect]
    rest = {field: v for field, v in values.items() if field not in entry.fields}
    known = replace(best.hypothesis, nominal=best.car(), assumed=effects_of(rest)).trusting([*rest.values()], AS_IT_WAS)
    phi = known.holding().start(best.car(), [*rest.values()])
    own = [values.get(field, p.off) for field, p in zip(entry.fields, entry.parameters, strict=True)]
    more, start = known.holding().with_effect(effect, phi, own)
    return values_of(refit(unedited.take, more, start, best.start, best.scales), effect)

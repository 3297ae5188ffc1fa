"""Questions about edited recordings: an effect made in a real drive must be found, and as large as it was made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bcid.diagnosis.diagnose import Diagnosis, diagnose_recordings
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.search.refits import estimates_by_symbol
from bcid.effects.table import ENTRIES, effect_ids
from bcid.errors import PredictionDiverged
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import refit
from bcid.likelihood.unnamed_functions import NO_REMAINDER
from bcid.proof.real.edits import EDITS
from bcid.proof.real.limits import LIMITS
from bcid.proof.real.oracle import fit_true_structure
from bcid.proof.real.question_files import QuestionInputs, reference_as_row, reference_from_row
from bcid.proof.real.questions import EditedQuestion
from bcid.proof.real.variations import AS_ASKED, QuestionVariation
from bcid.proof.rows import diagnosis_row
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


class UneditedDrive(NamedTuple):
    """What a drive shows before anything is edited in it."""

    simulation: ReferenceModel  # the drive's own model, trusted to `LIMITS.unedited_relative_sd`
    effect_values: dict[str, dict[str, tuple[float, float]]]  # value and standard error by effect and symbol

    def as_row(self) -> dict[str, Any]:
        """This drive's row, which is stored for the edits of the drive."""
        return {"simulation": reference_as_row(self.simulation), "effect_values": self.effect_values}

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> UneditedDrive:
        """The unedited drive of a stored row."""
        simulation = reference_from_row(row["simulation"])
        assert simulation is not None  # noqa: S101  # a drive has a model
        return cls(simulation, row["effect_values"])


def diagnose_unedited_drive(
    name: str, effects: Iterable[str], variation: QuestionVariation, inputs: QuestionInputs
) -> dict[str, Any]:
    """Diagnose the recording `name` before it is edited, twice, and fit each of `effects` to it, even if not named.

    Returns the row of an `UneditedDrive`, of the part of the recording that a `variation` keeps.

    The first diagnosis is against what is published, as well as that is known: a slow drive, or one that turns one way
    only, says little of most parameters.  The second is against all that the first shows, which becomes the drive's
    own model.  The edited recording is later diagnosed against that model; otherwise an effect that only a second
    diagnosis finds would be attributed to the edit.  An effect whose fit diverges is left out.
    """
    vehicle = inputs.vehicle_for(name)
    recording, estimate, _ = inputs.estimate_recording(name, vehicle, variation)
    published = inputs.published_model([estimate], vehicle)
    first = diagnose_recordings([recording], [estimate], vehicle, published)
    unedited = diagnose_recordings([recording], [estimate], vehicle, _trusted_simulation(first))
    found = UneditedDrive(_trusted_simulation(unedited), {})
    for effect in effects:
        before = none_if_diverged(_unedited_values, effect, unedited)  # a divergence concerns this edit alone
        if before is not None:
            found.effect_values[effect] = before
    return found.as_row()


def _trusted_simulation(diagnosis: Diagnosis) -> ReferenceModel:
    """All that a diagnosis shows, as a reference model whose parameters have a narrow prior when they are refitted.

    The model is a car with its named effects and what has no name: beside a car that lacks this, most of what an edit
    does could be more of the same.  The prior's relative standard deviation is `LIMITS.unedited_relative_sd`; what has
    no name is held.
    """
    return ReferenceModel.from_fit(diagnosis.whole_fit)._replace(relative_sd=LIMITS.unedited_relative_sd)


def answer_edited_question(
    question: EditedQuestion, variation: QuestionVariation, inputs: QuestionInputs, unedited_row: Mapping[str, Any]
) -> dict[str, Any]:
    """Edit a real recording so that its car has an effect of known size, and diagnose it; return the row to be scored.

    Poses or commands are edited, in the part of the recording that a `variation` keeps.  The reference of the diagnosis
    is the model of the unedited drive (`unedited_row`, by `diagnose_unedited_drive`) without the effect.  Beside
    `diagnosis_row` the row has "truth", the size of the edit, "before", the effect's values and standard errors in the
    unedited drive, "has", the effects of the reference, and, of the question AS_ASKED, what the edit is "worth";
    "gate" is that of its effect.

    Raises:
        PredictionDiverged: the effect could not be fitted to the unedited drive.
    """
    unedited = UneditedDrive.from_row(unedited_row)
    if question.effect not in unedited.effect_values:
        raise PredictionDiverged(f"a fit of {question.effect} to the unedited drive leaves the finite numbers")
    recording, estimate, vehicle = _edit_recording(question, unedited.simulation, variation, inputs)
    reference = unedited.simulation.without(question.effect)
    diagnosis = diagnose_recordings([recording], [estimate], vehicle, reference)
    before = unedited.effect_values[question.effect]
    more: dict[str, Any] = {"before": before, "has": list(effect_ids(reference.effects))}
    if variation == AS_ASKED:
        more |= _worth(question, before, diagnosis)
    gate = round(diagnosis.naming.gate_of(question.effect), 1)
    return {"truth": question.value, **more, **diagnosis_row(diagnosis), "gate": gate}


def _worth(
    question: EditedQuestion, before: Mapping[str, tuple[float, float]], diagnosis: Diagnosis
) -> dict[str, float]:
    """The nats by which the edited drive is likelier with the effect than without, both refitted, as "worth".

    It is left out where predictions with the effect diverge.
    """
    entry, without = ENTRIES[question.effect], diagnosis.naming.base
    sizes = [before[p.symbol][0] for p in entry.parameters]
    sizes[0] += question.value
    known = dict(zip(entry.fields, sizes, strict=True))
    true = none_if_diverged(fit_true_structure, without, without.hypothesis, diagnosis.take, [question.effect], known)
    return {"worth": round(true.nats, 1)} if true else {}


def _edit_recording(
    question: EditedQuestion, simulation: ReferenceModel, variation: QuestionVariation, inputs: QuestionInputs
) -> tuple[Recording, Estimate, Vehicle]:
    """Edit a real recording so that its car has the question's effect; return it, its estimated motion and the vehicle.

    The vehicle's steering limit is raised so that no edited command is clipped.  A steering offset is meant at the
    wheel, so it is divided by 1 + g if the unedited drive's `simulation` has a steering scale error g.
    """
    vehicle = inputs.vehicle_for(question.recording)
    recording, _, tuning = inputs.estimate_recording(question.recording, vehicle, variation)
    # the offset is meant at the wheel; where the drive shows that the wheel turns by 1 + g times the logged angle,
    # the log's offset is smaller by that factor
    gain = 1.0 + simulation.effects.get("steering_scale__g", 0.0) if question.effect == "steering_offset" else 1.0
    changed = EDITS[question.effect](recording, question.value / gain)
    reach = float(np.nanmax(np.abs(changed.commands.values[:, 0])))
    lock = {"max_angle_rad": max(vehicle.steering.max_angle_rad, reach)}
    vehicle = vehicle.model_copy(update={"steering": vehicle.steering.model_copy(update=lock)})
    return changed, estimate_motion(changed, vehicle, tuning), vehicle


def _unedited_values(effect: str, unedited: Diagnosis) -> dict[str, tuple[float, float]]:
    """Values and standard errors, by symbol, of an effect's parameters when it is fitted to a drive before the edit.

    Its parameters are free and start at their values in the diagnosis `unedited`, or off; all other effects found
    there have a prior of relative standard deviation `LIMITS.unedited_relative_sd`.  An effect bounded to one sign is
    fitted at about zero if the drive shows the other sign.
    """
    best, simulation = unedited.whole_fit, _trusted_simulation(unedited)
    values, entry = simulation.effects, best.hypothesis.entries[effect]
    rest = simulation.without(effect).effects
    known = replace(
        best.hypothesis, nominal=simulation.car, assumed=effect_ids(rest), known=simulation.known,
        remainder=NO_REMAINDER,
    )  # fmt: skip
    known = known.trust_simulation([*rest.values()], LIMITS.unedited_relative_sd).with_effects()
    phi = known.phi_of(best.car(), [*rest.values()])
    own = [values.get(field, p.off) for field, p in zip(entry.fields, entry.parameters, strict=True)]
    more, start = known.add_effect(effect, phi, own)
    return estimates_by_symbol(refit(unedited.take, more, start, best.start, best.scales), effect)

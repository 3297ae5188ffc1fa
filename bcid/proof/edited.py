"""Edited recordings: whether an effect that is made in a real drive is found, and as large as it was made."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from bcid.diagnosis.diagnose import Compared, Diagnosis, diagnosed
from bcid.diagnosis.simulation import of_parameters
from bcid.effects.table import EFFECTS
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.likelihood.refit import refit
from bcid.proof.asked import Asked
from bcid.proof.asking import said
from bcid.proof.edits import EDITS
from bcid.proof.real_cases import Edited
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

AS_IT_WAS = 0.02  # relative trust in what a recording showed before it was edited
NEAR, SURE = 0.25, 3.0  # of an edit's size, or standard errors, within which its value must be found,
FARTHEST = 0.5  # of its size, however large they are


def as_it_was(name: str, asked: Asked) -> Diagnosis:
    """What a recording shows before anything is edited in it, whether or not it has a name."""
    vehicle, start = asked.vehicle_of(name), None
    recording, estimate, _ = asked.moved(name, vehicle)
    if asked.simulation is not None:
        start = of_parameters(asked.simulation, [estimate], vehicle)._replace(trust=None)
    return diagnosed([recording], [estimate], vehicle, start)


def answered(case: Edited, unedited: Diagnosis, asked: Asked) -> dict[str, Any]:
    """What is made of an edited recording, of which all else is known; the effect itself is looked for anew.

    Its value has to be the edit's beyond what the drive showed of it `before`.
    """
    known = Compared.of(unedited.search.best)._replace(trust=AS_IT_WAS)
    before, unsure = _before(case.effect, unedited)
    rest = known._replace(effects={f: v for f, v in known.effects.items() if f.partition("__")[0] != case.effect})
    changed, estimate, vehicle = _changed(case, known, asked)
    answer = said(diagnosed([changed], [estimate], vehicle, rest))
    values = [next(iter(f["values"].values())) for f in answer["findings"] if f["effect"] == case.effect]
    value, se = values[0] if values else (None, 0.0)
    beside = [f["effect"] for f in answer["findings"] if f["effect"] != case.effect]
    near = min(max(NEAR * abs(case.value), SURE * math.hypot(se, unsure)), FARTHEST * abs(case.value))
    return {
        "tier": "edited", "recording": case.recording, "case": f"{case.effect} {case.value:g}", "truth": case.value,
        "before": before, "value": value, "beside": beside,
        "right": value is not None and abs(value - before - case.value) < near, **answer,
    }  # fmt: skip


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


def _before(effect: str, unedited: Diagnosis) -> tuple[float, float]:
    """What an unedited drive shows of an effect beside all else that it shows, with its standard error.

    As much as nothing where an effect is of one sign only and the drive would rather have the other.
    """
    best, field = unedited.search.best, EFFECTS[effect].fields[0]
    if effect in best.hypothesis.effects:
        return best.values()[field]
    values = list(best.hypothesis.values(best.phi).values())
    known = replace(best.hypothesis, nominal=best.car(), assumed=best.hypothesis.effects)
    more = known.trusting(values, AS_IT_WAS).holding(effect)
    start = more.start(best.car(), [*values, *(p.off for p in more.entries[effect].parameters)])
    return refit(unedited.take, more, start, best.start, best.scales).values()[field]

"""Edited recordings: whether an effect that is made in a real drive is found, and as large as it was made."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from bcid.diagnosis.diagnose import Compared, Diagnosis, diagnosed
from bcid.diagnosis.simulation import of_parameters
from bcid.diagnosis.verdict import values_of
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

    Its parameters have to be the edit's beyond what the drive showed of them `before`, and nothing else named: the
    first is as large as the edit, a second one nothing.
    """
    known = Compared.of(unedited.search.best)._replace(trust=AS_IT_WAS)
    before = _before(case.effect, unedited)
    rest = known._replace(effects={f: v for f, v in known.effects.items() if f.partition("__")[0] != case.effect})
    changed, estimate, vehicle = _changed(case, known, asked)
    answer = said(diagnosed([changed], [estimate], vehicle, rest))
    told = next((f["values"] for f in answer["findings"] if f["effect"] == case.effect), None)
    beside = [f["effect"] for f in answer["findings"] if f["effect"] != case.effect]
    first, *others = before
    made = {first: case.value, **dict.fromkeys(others, 0.0)}
    right = told is not None and all(_near(told[s], before[s], made[s], abs(case.value)) for s in made)
    return {
        "tier": "edited", "recording": case.recording, "case": f"{case.effect} {case.value:g}", "truth": case.value,
        "before": before[first][0], "value": told[first][0] if told else None, "beside": beside,
        "right": right and not beside, **answer,
    }  # fmt: skip


def _near(value: tuple[float, float], before: tuple[float, float], made: float, size: float) -> bool:
    """Whether a parameter is what was made of it beyond what it was before, for an edit of such a size."""
    off, se = value[0] - before[0] - made, math.hypot(value[1], before[1])
    return abs(off) < min(max(NEAR * size, SURE * se), FARTHEST * size)


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

    As much as nothing where an effect is of one sign only and the drive would rather have the other.
    """
    best = unedited.search.best
    if effect in best.hypothesis.effects:
        return values_of(best, effect)
    values = list(best.hypothesis.values(best.phi).values())
    known = replace(best.hypothesis, nominal=best.car(), assumed=best.hypothesis.effects)
    off = [p.off for p in known.entries[effect].parameters]
    more, start = known.trusting(values, AS_IT_WAS).with_effect(effect, best.phi, off)
    return values_of(refit(unedited.take, more, start, best.start, best.scales), effect)

"""Calibrate, then withhold: the simulation of a drive as the other drives of its day show the car.

A published figure is that of another day: battery, floor and servo are others.  So what is published is refitted
jointly to the other drives of the day, with the effects that at least half of them show beside it; the drive that is
asked is not among them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bcid.diagnosis.diagnose import diagnose_recordings, fit_base_model
from bcid.diagnosis.judge.free_functions import add_free_functions, held_out_share, scale_functions
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.search.refits import refit_with_effects
from bcid.effects.table import EFFECTS, ENTRIES
from bcid.likelihood.divergence import refuse_divergence
from bcid.proof.real.limits import LIMITS
from bcid.proof.real.question_files import QuestionInputs, reference_as_row
from bcid.proof.rows import diagnosis_row


def diagnose_drive(name: str, freely: bool, inputs: QuestionInputs) -> dict[str, Any]:
    """Diagnose a recording as a user would: against the published simulation, or `freely`, with none to compare.

    Returns `diagnosis_row` with "base" and "model", the base model and the fit with the names, as rows of reference
    models, and "unnamed", the arrays of free functions beside them, None where they may be chance or do no good.
    """
    vehicle = inputs.vehicle_for(name)
    recording, estimate, _ = inputs.estimate_recording(name, vehicle)
    published = None if freely else inputs.published_model([estimate], vehicle)
    diagnosis = diagnose_recordings([recording], [estimate], vehicle, published)
    models = {"base": diagnosis.naming.base, "model": diagnosis.fit}
    fits = {key: reference_as_row(ReferenceModel.from_fit(fit)) for key, fit in models.items()}
    fit, take, arrays = diagnosis.fit, diagnosis.take, None
    zero_s = float(recording.poses.time_s[0])
    share = held_out_share(fit, take, estimate, zero_s) if diagnosis.naming.unknown_nats > 0.0 else 0.0
    if share > 0.0:
        model = scale_functions(add_free_functions(fit, take, float(take.length_s[0]), estimate.period_s), share)
        arrays = {name: array.tolist() for name, array in model.to_saved()[1].items()}
    return {**diagnosis_row(diagnosis), **fits, "unnamed": arrays or None}


def calibrate_simulation(
    name: str, fellows: Sequence[str], inputs: QuestionInputs, *rows: Mapping[str, Any]
) -> dict[str, Any]:
    """The simulation of the recording `name` as its `fellows`, other recordings of that day, show it.

    `rows` are the fellows' diagnoses against the published simulation.  The published simulation is refitted jointly to
    the fellows, within what it is trusted to be; effects that the rows share (`shared_effects`) join, freely.  Returns
    "simulation", the row of a reference model that is trusted as the published one (None where nothing is published),
    "fellows", and "added", the effects that joined.  Without fellows it is the published simulation.

    Raises:
        InputRefused: too little of the fellows can be used, or the simulation cannot follow them.
    """
    vehicle = inputs.vehicle_for(name)
    if not fellows or inputs.simulation is None:
        _, estimate, _ = inputs.estimate_recording(name, vehicle)
        return {"simulation": reference_as_row(inputs.published_model([estimate], vehicle)), "fellows": [], "added": []}
    # columns and zeros are each drive's own
    read = [inputs.estimate_recording(fellow, inputs.vehicle_for(fellow)) for fellow in fellows]
    recordings, estimates, _ = zip(*read, strict=True)
    published = inputs.published_model(list(estimates), vehicle)
    assert published is not None  # noqa: S101  # there is a simulation
    base = fit_base_model(recordings, estimates, vehicle, published)
    added = {e: v for e, v in shared_effects(rows).items() if e in base.fit.hypothesis.entries}
    fit = base.fit
    if added:
        with refuse_divergence(recordings):
            fit = refit_with_effects(fit, base.take, tuple(added), [x for values in added.values() for x in values])
    day = ReferenceModel.from_fit(fit)
    simulation = published._replace(car=day.car, effects=day.effects)
    return {"simulation": reference_as_row(simulation), "fellows": list(fellows), "added": list(added)}


def shared_effects(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[float]]:
    """The effects that at least the share `LIMITS.min_day_share` of diagnoses show, with the mean of their values.

    A finding counts for its effect and for those that cannot be told from it; of these the one that most diagnoses
    show is taken, and where as many do, the one that is named itself most often.  Left out is what begins or changes
    with the time since a drive began: on another drive that is another time.
    """
    findings = [[f for f in row["findings"] if not _is_of_one_drive(f["effect"])] for row in rows]
    chosen = dict[str, list[float]]()
    while True:
        shown, named = Counter[str](), Counter[str]()
        for drive in findings:
            shown.update({e for f in drive for e in (f["effect"], *f["twins"]) if e in EFFECTS})
            named.update({f["effect"] for f in drive})
        effect = max(sorted(named), key=lambda e: (shown[e], named[e]), default=None)
        if effect is None or shown[effect] < LIMITS.min_day_share * len(rows):
            return chosen
        values = [f["values"] for drive in findings for f in drive if f["effect"] == effect]
        chosen[effect] = [float(np.mean([v[p.symbol][0] for v in values])) for p in EFFECTS[effect].parameters]
        findings = [[f for f in drive if effect not in (f["effect"], *f["twins"])] for drive in findings]


def _is_of_one_drive(effect: str) -> bool:
    """Whether an effect varies with the time since a drive began, or is none of the vocabulary."""
    return effect not in EFFECTS or "time" in ENTRIES[effect].depends_on

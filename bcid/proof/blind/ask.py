"""One case: drive, recording, diagnosis, and all of it that is scored."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from bcid.diagnosis.diagnose import Diagnosis, diagnosed
from bcid.diagnosis.judge.held_out import scores
from bcid.effects.table import EFFECTS
from bcid.estimate.run import estimate_motion
from bcid.likelihood.refit import refit
from bcid.proof.rows import said
from bcid.simulation.drive import Drive
from bcid.virtual_lab import TUNING, recorded, vehicle


def answered(
    run: Drive, rate_hz: float, left_out: tuple[str, ...], truth: Mapping[str, Mapping[str, float]]
) -> tuple[dict[str, Any], Diagnosis]:
    """What the diagnosis says of a drive's recording, as it is scored and whole.

    It sees the recording and the vehicle file, and what it may not name.  The `truth`, parameters by effect of what it
    could have named, is held beside its answer afterwards.  How cases are made and scored is not known here, so that
    rows outlive changes of either.
    """
    of = vehicle()
    recording = recorded(run, rate_hz, of, "concealed")
    begin = time.perf_counter()
    estimate = estimate_motion(recording, of, TUNING)
    found = diagnosed([recording], [estimate], of, left_out=left_out)
    seconds = time.perf_counter() - begin
    return {**said(found), "seconds": round(seconds, 2), **_oracle(truth, found)}, found


def _oracle(truth: Mapping[str, Mapping[str, float]], found: Diagnosis) -> dict[str, Any]:
    """Held-out gain of what was found, over that of refitting the true structure from the true values.

    And whether that is worth more than chance: else the recording does not show the effect at all.  Nothing of several
    effects.
    """
    if len(truth) != 1:
        return {"oracle_share": None}
    corrected, fit, take = found.search.corrected, found.judgement.fit, found.take
    ((effect, parameters),) = truth.items()
    held = (*(n for n in fit.hypothesis.effects if n not in EFFECTS), effect)
    hypothesis, old = corrected.hypothesis.holding(*held), fit.values()
    values = [
        parameters[p.symbol] if name == effect else old[field][0]
        for name in held
        for field, p in zip(hypothesis.entries[name].fields, hypothesis.entries[name].parameters, strict=True)
    ]
    near = fit if hypothesis.effects == fit.hypothesis.effects else corrected
    try:
        oracle = refit(take, hypothesis, hypothesis.start(near.car(), values), near.start, near.scales)
    except FloatingPointError:
        return {"oracle_share": None}
    nothing = scores(corrected, take).sum()
    best = scores(oracle, take).sum() - nothing
    reached = scores(fit, take).sum() - nothing if fit is not corrected else 0.0
    shown = bool(best > found.judgement.gate)
    return {"oracle_share": float(reached / best) if shown else None, "shown": shown}

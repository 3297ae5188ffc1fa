"""A published model less one of its effects, or of what its vehicle file knows, must be told which one."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.compared import Compared
from bcid.diagnosis.diagnose import based, diagnosed
from bcid.diagnosis.judge.prediction_error import compared_model
from bcid.diagnosis.reference import of_parameters
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import restarted
from bcid.proof.real.question_files import Asked
from bcid.proof.real.questions import NOT_ASKED, Withheld
from bcid.proof.rows import said
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

HORIZON_S = 1.0
MOVING = 0.3  # m/s: slower predictions are not compared
MATTERS = 1.3  # times the error with everything, from which what is withheld must be named


def answered(case: Withheld, asked: Asked) -> dict[str, Any]:
    """What is made of a recording where something is withheld; not asked where that makes no difference."""
    vehicle = asked.vehicle_of(case.recording, case.vehicle)
    recording, estimate, _ = asked.moved(case.recording, vehicle)
    less, published, ratio = None, dict[str, float](), 1.0
    if asked.simulation is not None:
        whole = of_parameters(asked.simulation, [estimate], vehicle)
        less = whole.without(case.effect)._replace(car=whole.car._replace(**case.parameters))
        published = {field: value for field, value in whole.effects.items() if field not in less.effects}
    if case.withholds:
        ratio = float((_errors(less, vehicle, recording, estimate) / _errors_of_the_whole(case, asked)).max())
    row = {"ratio": round(ratio, 3) if np.isfinite(ratio) else None, "published": published}
    if not (case.control or ratio > MATTERS):
        return {**row, "verdict": NOT_ASKED, "findings": []}
    return {**row, **said(diagnosed([recording], [estimate], vehicle, less))}


def _errors_of_the_whole(case: Withheld, asked: Asked) -> Floats:
    """`errors` with nothing withheld.

    Raises:
        InputRefused: where they are endless.
    """
    vehicle = asked.vehicle_of(case.recording)
    recording, estimate, _ = asked.moved(case.recording, vehicle)
    published = None if asked.simulation is None else of_parameters(asked.simulation, [estimate], vehicle)
    found = _errors(published, vehicle, recording, estimate)
    if not np.isfinite(found).all():
        nowhere = "with nothing withheld the simulation leaves the finite numbers"
        raise InputRefused(asked.recordings / case.recording, case.name, nowhere, "ask of a drive that it can follow")
    return found


def _errors(simulation: Compared | None, vehicle: Vehicle, recording: Recording, estimate: Estimate) -> Floats:
    """`errors` of the simulation; without one, of the base model refitted, without pushes: it is to predict alone."""
    return errors(simulation or Compared.of(based([recording], [estimate], vehicle).fit), vehicle, estimate)


def errors(simulation: Compared, vehicle: Vehicle, estimate: Estimate) -> Floats:
    """RMSE of v_x (m/s) and yaw rate (rad/s) of the simulation as it is, started anew every HORIZON_S.

    Endless where it leaves the finite numbers.
    """
    model = compared_model(simulation, vehicle, float(np.ptp(estimate.time_s)), estimate.period_s)
    off = (restarted(model, estimate, HORIZON_S).twist - estimate.twist)[:, [0, 2]]
    known = np.isfinite(estimate.twist).all(axis=1) & (np.abs(estimate.twist[:, 0]) > MOVING)
    return np.asarray(np.sqrt(np.mean(np.nan_to_num(off[known], nan=np.inf) ** 2, axis=0)))

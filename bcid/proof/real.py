"""Real recordings with a known omission: a published model less one of its effects must be told which one.

Controls are what must not be named: an effect that a drive does not excite, or any vehicle physics where the tracking
failed, beyond what other drives of the car show as well.  A last tier edits recordings (`bcid.proof.edits`), so that
what the edited ones show beyond the recording as it was is known exactly.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence, Set
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bcid.diagnosis.before_after import compared_model
from bcid.diagnosis.diagnose import Compared, based, diagnosed
from bcid.diagnosis.simulation import of_parameters
from bcid.effects.table import EFFECTS
from bcid.errors import BcidError, InputRefused
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import restarted
from bcid.likelihood.recordings import suited
from bcid.proof import edited
from bcid.proof.asked import Asked
from bcid.proof.asking import said
from bcid.proof.keeping import keep, kept
from bcid.proof.real_cases import NOT_ASKED, VEHICLE, Edited, Withheld, read_cases
from bcid.proof.running import pool_of
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.store.code import code_of
from bcid.vehicle import Vehicle, read_vehicle

Floats = npt.NDArray[np.float64]

HORIZON_S = 1.0
MOVING = 0.3  # m/s: slower predictions are not compared
MATTERS = 1.3  # times the error with everything, from which what is withheld must be named


_Case = tuple[Withheld | Edited, str]  # and the key of its row


def run_real(file: Path, recordings: Path, folder: Path, workers: int = 1) -> Iterator[tuple[dict[str, Any], float]]:
    """A row for each case of the TOML `file`, kept in `folder`, each as it is done, and the share that is done.

    `recordings` is where the recordings are.

    Raises:
        InputRefused: the file, or what it names.
    """
    cases = read_cases(file)
    simulation = cases.simulation_file(file)
    asked = Asked(read_vehicle(cases.vehicle_file(file)), cases.calibrated, simulation, recordings)
    asked.check(cases, file)
    folder.mkdir(parents=True, exist_ok=True)
    code, drives = code_of(__name__), dict[str, str]()
    given = [p.read_text(encoding="utf-8") for p in (cases.vehicle_file(file), simulation) if p]
    asking: tuple[Withheld | Edited, ...] = (*cases.withheld, *cases.edited)
    known, done, todo = kept(folder), 0, dict[str, list[_Case]]()
    for case in asking:
        own, name = cases.calibrated.get(case.recording), case.recording
        if name not in drives:
            drives[name] = read_recording(recordings / name, asked.vehicle_of(name)).sha256  # commands may lie beside
        what = [case.model_dump(), own, drives[name], code.digest, code.packages, given]
        key = f"real.{hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:24]}"
        if key in known:
            done += 1
            yield known[key], done / len(asking)
        else:  # the edits of a recording share what it showed before
            todo.setdefault(case.recording if isinstance(case, Edited) else key, []).append((case, key))
    for rows in _answered(list(todo.values()), asked, folder, workers):
        for row in rows:
            done += 1
            yield row, done / len(asking)


def _answered(
    groups: Sequence[list[_Case]], asked: Asked, folder: Path, workers: int
) -> Iterator[list[dict[str, Any]]]:
    """The rows of each group as it is done."""
    if workers <= 1:
        yield from (_rows(group, asked, folder) for group in groups)
        return
    with pool_of(workers) as pool:
        longest_first = sorted(groups, key=len, reverse=True)
        for ended in as_completed([pool.submit(_rows, group, asked, folder) for group in longest_first]):
            yield ended.result()


def _rows(group: list[_Case], asked: Asked, folder: Path) -> list[dict[str, Any]]:
    """What was answered, kept in `folder`; edits are of one recording.

    What ended in an error is told, and asked again next time.
    """
    rows, unedited = list[dict[str, Any]](), None
    for case, key in group:
        try:
            if isinstance(case, Withheld):
                row = _withheld(case, asked)
            else:
                unedited = unedited or edited.as_it_was(case.recording, asked)
                row = edited.answered(case, unedited, asked)
            keep(row, key, folder)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError, BcidError) as error:
            row = _failed(case, error)
        rows.append(row)
    return rows


def _failed(case: Withheld | Edited, error: Exception) -> dict[str, Any]:
    """A question without an answer."""
    tier, name = ("edited", case.effect) if isinstance(case, Edited) else (_tier(case), case.name)
    said = {"right": False, "verdict": "error", "findings": [], "error": repr(error)}
    return {"tier": tier, "recording": case.recording, "case": name, **said}


def _tier(case: Withheld) -> str:
    return "control" if case.control else "withheld"


def _withheld(case: Withheld, asked: Asked) -> dict[str, Any]:
    """What is made of a recording where something is withheld; not asked where that makes no difference."""
    vehicle = asked.vehicle_of(case.recording, case.vehicle)
    recording, estimate, _ = asked.moved(case.recording, vehicle)
    less, ratio = None, 1.0
    if asked.simulation is not None:
        less = _less(case, of_parameters(asked.simulation, [estimate], vehicle))
    if case.withholds:
        whole = _errors_of_the_whole(case, asked)
        if not np.isfinite(whole).all():
            nowhere = "with nothing withheld the simulation leaves the finite numbers"
            raise InputRefused(
                asked.recordings / case.recording, case.name, nowhere, "ask of a drive that it can follow"
            )
        ratio = float((_errors(less, vehicle, recording, estimate) / whole).max())
    wanted = not case.control and ratio > MATTERS
    row = {
        "tier": _tier(case), "recording": case.recording, "case": case.name,
        "ratio": round(ratio, 3) if np.isfinite(ratio) else None, "wanted": wanted,
    }  # fmt: skip
    if not (wanted or case.control):
        return {**row, "right": True, "verdict": NOT_ASKED, "findings": []}
    answer = said(diagnosed([recording], [estimate], vehicle, less))
    sets = [{f["effect"], *f["twins"]} for f in answer["findings"]]
    met = [_accepted(names, case.accepted) for names in sets]
    beside = [f["effect"] for f, is_met in zip(answer["findings"], met, strict=True) if not is_met]
    if case.control:
        told = _parts(set().union(*sets, _nameless(answer)))
        right = not _with_kinds(told - set(case.known)) & set(case.accepted)
    else:
        right = any(met) or _accepted(_nameless(answer), case.accepted)
    return {**row, "first": right and (not met or met[0]), "beside": beside, "right": right, **answer}


def _accepted(names: Set[str], accepted: Sequence[str]) -> bool:
    """Whether one of the names is accepted; several that are alike only together, if all of them are."""
    return any(set(name.split("+")) <= set(accepted) for name in names)


def _nameless(answer: Mapping[str, Any]) -> set[str]:
    """What the answer says of what has no name."""
    return {f"unknown in {answer['remainder']['channel']}"} if answer["verdict"] == "unknown" else set()


def _parts(names: Set[str]) -> set[str]:
    """Every effect that the names may mean."""
    return {part for name in names for part in name.split("+")}


def _with_kinds(named: Set[str]) -> set[str]:
    """The names, and VEHICLE where one of them is the vehicle's."""
    return {*named, *(EFFECTS[e].kind for e in named if e in EFFECTS and EFFECTS[e].kind == VEHICLE)}


def _less(case: Withheld, published: Compared) -> Compared:
    """The simulation without what the case withholds of it."""
    return published._replace(
        car=published.car._replace(**case.parameters),
        effects={f: v for f, v in published.effects.items() if f.partition("__")[0] != case.effect},
    )


def _errors_of_the_whole(case: Withheld, asked: Asked) -> Floats:
    """`errors` with nothing withheld."""
    vehicle = asked.vehicle_of(case.recording)
    recording, estimate, _ = asked.moved(case.recording, vehicle)
    published = None if asked.simulation is None else of_parameters(asked.simulation, [estimate], vehicle)
    return _errors(published, vehicle, recording, estimate)


def _errors(simulation: Compared | None, vehicle: Vehicle, recording: Recording, estimate: Estimate) -> Floats:
    """`errors` of the simulation; without one, of the base model refitted."""
    if simulation is None:
        of = based([recording], [estimate], vehicle)
        simulation = Compared.of(suited(of.take, of.fit)[1])
    return errors(simulation, vehicle, estimate)


def errors(simulation: Compared, vehicle: Vehicle, estimate: Estimate) -> Floats:
    """RMSE of v_x (m/s) and yaw rate (rad/s) of the simulation as it is, started anew every HORIZON_S.

    Endless where it leaves the finite numbers.
    """
    model = compared_model(simulation, vehicle, float(np.ptp(estimate.time_s)), estimate.period_s)
    off = (restarted(model, estimate, HORIZON_S).twist - estimate.twist)[:, [0, 2]]
    known = np.isfinite(estimate.twist).all(axis=1) & (np.abs(estimate.twist[:, 0]) > MOVING)
    return np.asarray(np.sqrt(np.mean(np.nan_to_num(off[known], nan=np.inf) ** 2, axis=0)))

"""Real recordings with a known omission: a published model less one of its effects must be told which one.

Controls are what must not be named: an effect that a drive does not excite, or any vehicle physics where the tracking
failed.  A last tier edits recordings (`bcid.proof.edits`), so that what the edited ones show beyond the recording as it
was is known exactly.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from bcid.diagnosis.before_after import compared_model
from bcid.diagnosis.diagnose import Compared, Diagnosis, diagnosed
from bcid.diagnosis.simulation import of_parameters
from bcid.effects.table import EFFECTS
from bcid.errors import InputRefused
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning, tune
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import restarted
from bcid.likelihood.refit import Fit
from bcid.proof.asking import said
from bcid.proof.edits import EDITS
from bcid.proof.keeping import keep
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.store.artifact import sha256_of
from bcid.store.code import code_of
from bcid.toml_file import Settings, read_toml
from bcid.vehicle import Vehicle, read_vehicle

Floats = npt.NDArray[np.float64]

SCHEMA = "bcid.prove-real/1"
HORIZON_S = 1.0
MOVING = 0.3  # m/s: slower predictions are not compared
MATTERS = 1.3  # times the error with everything, from which what is withheld must be named
AS_IT_WAS = 0.02  # relative trust in what a recording showed before it was edited
NEAR, SURE = 0.25, 3.0  # of an edit's size, or standard errors, within which its value must be found
VEHICLE = "vehicle"


class Withheld(Settings):
    """What the simulation is denied: an effect, parameters, or what the vehicle file knows."""

    recording: str
    name: str
    effect: str = ""
    parameters: dict[str, float] = Field(default_factory=dict)  # of the simulation, that make it so
    vehicle: dict[str, Any] = Field(default_factory=dict)  # tables laid over the vehicle file's
    accepted: list[str]  # ids, "unknown in CHANNEL", or "vehicle" for all that is neither measurement nor floor
    control: bool = False  # none of `accepted` may be named


class Edited(Settings):
    """An effect made in a real recording."""

    recording: str
    effect: str
    value: float


class Cases(Settings):
    """What is asked of real recordings of one vehicle; files count from this one, recordings from their folder."""

    vehicle: str
    simulation: str | None = None  # none: the base model is refitted to each recording
    withheld: list[Withheld] = Field(default_factory=list)
    edited: list[Edited] = Field(default_factory=list)


class _Asked(NamedTuple):
    """One vehicle's files, read."""

    file: Path
    vehicle: Vehicle
    simulation: Path | None
    recordings: Path
    known: dict[str, Compared]  # recordings identified as they are, by name


def run_real(file: Path, recordings: Path, folder: Path) -> Iterator[tuple[dict[str, Any], float]]:
    """A row for each case of the TOML `file`, kept in `folder`, and the share that is done.

    `recordings` is where the recordings are.

    Raises:
        InputRefused: the file, or what it names.
    """
    cases = read_toml(file, Cases, "file of real cases", "pipelines/dart/cases.toml is one")
    simulation = None if cases.simulation is None else file.parent / cases.simulation
    asked = _Asked(file, read_vehicle(file.parent / cases.vehicle), simulation, recordings, {})
    _check(cases, asked)
    folder.mkdir(parents=True, exist_ok=True)
    code = code_of(__name__)
    given = [p.read_text(encoding="utf-8") for p in (file.parent / cases.vehicle, simulation) if p]
    asking: tuple[Withheld | Edited, ...] = (*cases.withheld, *cases.edited)
    for k, case in enumerate(asking, start=1):
        what = [case.model_dump(), sha256_of(recordings / case.recording), code.digest, code.packages, given]
        kept = folder / f"real.{hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:24]}.json"
        if not kept.is_file():
            keep(_withheld(case, asked) if isinstance(case, Withheld) else _edited(case, asked), kept)
        yield json.loads(kept.read_text(encoding="utf-8")), k / len(asking)


def _check(cases: Cases, asked: _Asked) -> None:
    """Refuse what would be answered rightly by asking nothing."""
    effects = (
        set(tomllib.loads(asked.simulation.read_text(encoding="utf-8")).get("effects", {}))
        if asked.simulation
        else set()
    )
    for case in cases.withheld:
        place = f"withheld {case.name!r}"
        if case.effect and case.effect not in effects:
            raise InputRefused(
                asked.file, place, f"the simulation has no {case.effect!r}", f"one of {', '.join(effects)}"
            )
        strange = [a for a in case.accepted if a not in EFFECTS and a != VEHICLE and not a.startswith("unknown in ")]
        if strange or not case.accepted:
            raise InputRefused(asked.file, place, f"accepts {strange or 'nothing'}", "see `bcid effects` for the ids")
        if case.parameters and asked.simulation is None:
            raise InputRefused(asked.file, place, "changes parameters of no simulation", "name a simulation")
    for edit in cases.edited:
        if edit.effect not in EDITS:
            raise InputRefused(asked.file, f"edited {edit.effect!r}", "no such edit", f"one of {', '.join(EDITS)}")


def _laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of `above` over those of `below`."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        merged[key] = _laid_over(under, value) if isinstance(value, Mapping) and isinstance(under, Mapping) else value
    return merged


def _moved(name: str, vehicle: Vehicle, asked: _Asked) -> tuple[Recording, Estimate, Tuning]:
    recording = read_recording(asked.recordings / name, vehicle)
    tuning = tune([recording], vehicle, 0.1, 0.3, {})
    return recording, estimate_motion(recording, vehicle, tuning), tuning


def _withheld(case: Withheld, asked: _Asked) -> dict[str, Any]:
    vehicle = Vehicle.model_validate(_laid_over(asked.vehicle.model_dump(), case.vehicle))
    recording, estimate, _ = _moved(case.recording, vehicle, asked)
    less: Compared | None = None
    if asked.simulation is not None:
        published = of_parameters(asked.simulation, [estimate], vehicle)
        less = published._replace(
            car=published.car._replace(**case.parameters),
            effects={f: v for f, v in published.effects.items() if f.partition("__")[0] != case.effect},
        )
    found = diagnosed([recording], [estimate], vehicle, less)
    row = said(found)
    named = {e for f in row["findings"] for e in (f["effect"], *f["twins"])}
    if any(EFFECTS[e].kind == "vehicle" for e in named):
        named.add(VEHICLE)
    if row["verdict"] == "unknown":
        named.add(f"unknown in {row['remainder']['channel']}")
    without = errors(less or _of_fit(found.search.base), vehicle, estimate)
    ratio = float((without / _errors_of_the_whole(case, asked)).max()) if _denied(case) else 1.0
    told = bool(named & set(case.accepted))
    wanted = not case.control and ratio > MATTERS
    return {
        "tier": "control" if case.control else "withheld", "recording": case.recording, "case": case.name,
        "ratio": round(ratio, 3), "wanted": wanted,
        "right": not told if case.control else told or not wanted, **row,
    }  # fmt: skip


def _denied(case: Withheld) -> bool:
    return bool(case.effect or case.parameters or case.vehicle)


def _of_fit(fit: Fit) -> Compared:
    return Compared(fit.car(), fit.hypothesis.values(fit.phi))


def _errors_of_the_whole(case: Withheld, asked: _Asked) -> Floats:
    """Errors of the simulation, or of the refitted base model, with everything."""
    _, estimate, _ = _moved(case.recording, asked.vehicle, asked)
    if asked.simulation is not None:
        return errors(of_parameters(asked.simulation, [estimate], asked.vehicle), asked.vehicle, estimate)
    return errors(_of_fit(_identified(case.recording, asked, None).search.base), asked.vehicle, estimate)


def _identified(name: str, asked: _Asked, simulation: Compared | None) -> Diagnosis:
    recording, estimate, _ = _moved(name, asked.vehicle, asked)
    return diagnosed([recording], [estimate], asked.vehicle, simulation)


def errors(simulation: Compared, vehicle: Vehicle, estimate: Estimate) -> Floats:
    """RMSE of v_x (m/s) and yaw rate (rad/s) of the simulation as it is, started anew every HORIZON_S."""
    model = compared_model(simulation, vehicle, float(np.ptp(estimate.time_s)), estimate.period_s)
    off = restarted(model, estimate, HORIZON_S).twist - estimate.twist
    fast = np.abs(estimate.twist[:, 0]) > MOVING
    return np.asarray(np.sqrt(np.nanmean(off[fast][:, [0, 2]] ** 2, axis=0)))


def _edited(case: Edited, asked: _Asked) -> dict[str, Any]:
    recording, estimate, tuning = _moved(case.recording, asked.vehicle, asked)
    if case.recording not in asked.known:
        start = (
            of_parameters(asked.simulation, [estimate], asked.vehicle)._replace(trust=None)
            if asked.simulation
            else None
        )
        asked.known[case.recording] = _of_fit(_identified(case.recording, asked, start).search.best)
    known = asked.known[case.recording]._replace(trust=AS_IT_WAS)
    changed = EDITS[case.effect](recording, case.value)
    row = said(diagnosed([changed], [estimate_motion(changed, asked.vehicle, tuning)], asked.vehicle, known))
    values = [next(iter(f["values"].values())) for f in row["findings"] if f["effect"] == case.effect]
    value, se = values[0] if values else (None, 0.0)
    beside = [f["effect"] for f in row["findings"] if f["effect"] != case.effect]
    return {
        "tier": "edited", "recording": case.recording, "case": f"{case.effect} {case.value:g}", "truth": case.value,
        "value": value, "beside": beside,
        "right": value is not None and abs(value - case.value) < max(NEAR * abs(case.value), SURE * se), **row,
    }  # fmt: skip


def outcome(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All rows, and right answers of how many, tier by tier.

    What makes no difference to the error where it is withheld does not count.
    """
    counted = [r for r in rows if r.get("wanted", True) or r["tier"] == "control"]
    tiers = {
        tier: {"right": sum(r["right"] for r in of), "n": len(of)}
        for tier in dict.fromkeys(r["tier"] for r in rows)
        for of in [[r for r in counted if r["tier"] == tier]]
    }
    return {"schema": SCHEMA, "code": code_of(__name__).digest, "tiers": tiers, "rows": list(rows)}

"""Real recordings with a known omission: a published model less one of its effects must be told which one.

A second tier edits real recordings in ways that can be undone, so that what the edited ones show beyond the
recording as it was is known exactly.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from bcid.diagnosis.before_after import compared_model
from bcid.diagnosis.diagnose import Compared, diagnosed
from bcid.diagnosis.simulation import of_parameters
from bcid.errors import InputRefused
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning, tune
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import restarted
from bcid.proof.asking import said
from bcid.proof.keeping import keep
from bcid.recording.read import read_recording
from bcid.recording.types import Recording, Stream
from bcid.store.code import code_of
from bcid.toml_file import Settings, read_toml
from bcid.vehicle import Vehicle, read_vehicle

Floats = npt.NDArray[np.float64]

SCHEMA = "bcid.prove-real/1"
HORIZON_S = 1.0
MOVING = 0.3  # m/s: slower predictions are not compared
MATTERS = 1.3  # times the error with everything, from which what is withheld must be named


class Withheld(Settings):
    """An effect that the simulation is denied, or parameters that make it so."""

    recording: str
    name: str
    effect: str = ""
    parameters: dict[str, float] = Field(default_factory=dict)
    accepted: list[str]
    control: bool = False  # it is not excited there: none of `accepted` may be named


class Edited(Settings):
    """An effect made in a real recording."""

    recording: str
    effect: str
    value: float


class Cases(Settings):
    """What is asked of real recordings of one vehicle; files count from this one, recordings from their folder."""

    vehicle: str
    simulation: str
    withheld: list[Withheld] = Field(default_factory=list)
    edited: list[Edited] = Field(default_factory=list)


class _Asked(NamedTuple):
    """One vehicle's files, read."""

    vehicle: Vehicle
    simulation: Path
    recordings: Path


def run_real(file: Path, recordings: Path, folder: Path) -> Iterator[tuple[dict[str, Any], float]]:
    """A row for each case of the TOML `file`, kept in `folder`, and the share that is done.

    `recordings` is where the recordings are.

    Raises:
        InputRefused: the file, or what it names.
    """
    cases = read_toml(file, Cases, "file of real cases", "pipelines/dart/cases.toml is one")
    asked = _Asked(read_vehicle(file.parent / cases.vehicle), file.parent / cases.simulation, recordings)
    folder.mkdir(parents=True, exist_ok=True)
    code = code_of(__name__).digest
    given = [p.read_text(encoding="utf-8") for p in (file.parent / cases.vehicle, asked.simulation)]
    asking: tuple[Withheld | Edited, ...] = (*cases.withheld, *cases.edited)
    for k, case in enumerate(asking, start=1):
        key = hashlib.sha256(json.dumps([case.model_dump(), code, given]).encode()).hexdigest()[:24]
        kept = folder / f"real.{key}.json"
        if not kept.is_file():
            keep(_withheld(case, asked) if isinstance(case, Withheld) else _edited(case, asked), kept)
        yield json.loads(kept.read_text(encoding="utf-8")), k / len(asking)


def _moved(name: str, asked: _Asked) -> tuple[Recording, Estimate, Tuning]:
    recording = read_recording(asked.recordings / name, asked.vehicle)
    tuning = tune([recording], asked.vehicle, 0.1, 0.3, {})
    return recording, estimate_motion(recording, asked.vehicle, tuning), tuning


def _withheld(case: Withheld, asked: _Asked) -> dict[str, Any]:
    recording, estimate, _ = _moved(case.recording, asked)
    whole = of_parameters(asked.simulation, [estimate], asked.vehicle)
    less = whole._replace(
        car=whole.car._replace(**case.parameters),
        effects={f: v for f, v in whole.effects.items() if f.partition("__")[0] != case.effect},
    )
    row = said(diagnosed([recording], [estimate], asked.vehicle, less))
    named = {e for f in row["findings"] for e in (f["effect"], *f["twins"])}
    if row["verdict"] == "unknown":
        named.add(f"unknown in {row['remainder']['channel']}")
    ratios = errors(less, asked.vehicle, estimate) / errors(whole, asked.vehicle, estimate)
    told = bool(named & set(case.accepted))
    wanted = not case.control and float(ratios.max()) > MATTERS
    return {
        "tier": "control" if case.control else "withheld", "recording": case.recording, "case": case.name,
        "ratio": round(float(ratios.max()), 3), "wanted": wanted,
        "right": not told if case.control else told or not wanted, **row,
    }  # fmt: skip


def errors(simulation: Compared, vehicle: Vehicle, estimate: Estimate) -> Floats:
    """RMSE of v_x (m/s) and yaw rate (rad/s) of the simulation as it is, started anew every HORIZON_S."""
    model = compared_model(simulation, vehicle, float(np.ptp(estimate.time_s)), estimate.period_s)
    off = restarted(model, estimate, HORIZON_S).twist - estimate.twist
    fast = np.abs(estimate.twist[:, 0]) > MOVING
    return np.asarray(np.sqrt(np.nanmean(off[fast][:, [0, 2]] ** 2, axis=0)))


def _edited(case: Edited, asked: _Asked) -> dict[str, Any]:
    if case.effect not in EDITS:
        raise InputRefused(asked.simulation.parent, case.effect, "no such edit", f"one of {', '.join(EDITS)}")
    recording, estimate, tuning = _moved(case.recording, asked)
    published = of_parameters(asked.simulation, [estimate], asked.vehicle)
    before = diagnosed([recording], [estimate], asked.vehicle, published._replace(trust=None)).search.best
    known = Compared(before.car(), before.hypothesis.values(before.phi), published.trust)
    changed = EDITS[case.effect](recording, case.value)
    row = said(diagnosed([changed], [estimate_motion(changed, asked.vehicle, tuning)], asked.vehicle, known))
    values = [next(iter(f["values"].values()))[0] for f in row["findings"] if f["effect"] == case.effect]
    return {
        "tier": "edited", "recording": case.recording, "case": f"{case.effect} {case.value:g}", "truth": case.value,
        "value": values[0] if values else None, "right": bool(values), **row,
    }  # fmt: skip


def _later(of: Recording, tau: float) -> Recording:
    return replace(of, poses=Stream(of.poses.time_s + tau, of.poses.values))


def _posed(of: Recording, factor: float = 1.0, turned: float = 0.0) -> Recording:
    return replace(of, poses=Stream(of.poses.time_s, of.poses.values * [factor, factor, 1.0] + [0.0, 0.0, turned]))


def _shifted(of: Recording, d: float) -> Recording:
    x, y, yaw = of.poses.values.T
    values = np.column_stack([x + d * np.cos(yaw), y + d * np.sin(yaw), yaw])
    return replace(of, poses=Stream(of.poses.time_s, values))


def _commanded(of: Recording, angle: Callable[[Floats], Floats]) -> Recording:
    """With other logged steering commands."""
    values = of.commands.values.copy()
    values[:, 0] = angle(values[:, 0])
    return replace(of, commands=Stream(of.commands.time_s, values))


def _earlier(of: Recording, tau: float, which: int) -> Recording:
    """One of the commands logged `tau` before it came: as if it acted that much later."""
    t, values = of.commands.time_s, of.commands.values
    times = np.union1d(t, t - tau)
    times = times[(times >= t[0]) & (times <= t[-1] - tau)]
    now = values[np.searchsorted(t, times, side="right") - 1].copy()
    now[:, which] = values[np.searchsorted(t, times + tau, side="right") - 1, which]
    return replace(of, commands=Stream(times, now))


EDITS: Mapping[str, Callable[[Recording, float], Recording]] = {
    "pose_latency": _later,
    "marker_offset": _shifted,
    "body_yaw_misalignment": lambda of, psi: _posed(of, turned=psi),
    "pose_scale": lambda of, kappa: _posed(of, factor=1.0 + kappa),
    "steering_offset": lambda of, o: _commanded(of, lambda u: u - o),
    "steering_side_gain": lambda of, a: _commanded(of, lambda u: u / (1.0 + a * np.sign(u))),
    "steering_delay": lambda of, tau: _earlier(of, tau, 0),
    "motor_delay": lambda of, tau: _earlier(of, tau, 1),
}
"""What is done to a recording so that the car in it has the effect of this size."""


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

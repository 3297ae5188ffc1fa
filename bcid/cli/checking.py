"""`bcid ingest --check`: the health of recordings, all of them, whatever is wrong with some."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bcid.cli.options import plan_of
from bcid.cli.sink import Sink
from bcid.errors import InputRefused, PartLost, Problem, Problems, UsageError
from bcid.vehicle import Vehicle, read_vehicle

if TYPE_CHECKING:
    from bcid.recording.types import Recording


def checked(
    pipeline: Path | None,
    recordings: list[Path] | None,
    vehicle: Path | None,
    commands: Path | None,
    allow_partial: bool,
) -> list[dict[str, Any]]:
    """Of each recording its health, or why it is refused."""
    from bcid.recording.checks.health import health
    from bcid.recording.formats.detect import commands_of

    if commands is not None and len(recordings or []) != 1:
        raise UsageError("--commands goes with one recording\n  next: name the others' commands NAME.commands.csv")
    if recordings:
        if vehicle is None and pipeline is None:
            raise UsageError("recordings need --vehicle VEHICLE.toml\n  next: `bcid init` writes one")
        of = read_vehicle(vehicle or plan_of(pipeline).vehicle)
        paths = recordings
    else:
        plan = plan_of(pipeline, vehicle=vehicle)
        of, paths = read_vehicle(plan.vehicle), [*plan.training, *([plan.validation] if plan.validation else [])]
    told = []
    for path in paths:
        row: dict[str, Any] = {"recording": str(path)}
        try:
            recording = _read(path, of, commands_of(path, commands), allow_partial)
        except InputRefused as error:
            why = "; ".join(f"{p.place}: {p.cause}" for p in error.problems)
            no = {"go": False, "sentence": f"no-go: refused, {why}", "refused": str(error), "lost": False}
            told.append(row | no | {"problems": [p._asdict() for p in error.problems]})
            continue
        lost = any(i.kind == "lost" for i in recording.irregularities)
        found = health(recording, of).as_json()
        told.append(row | found | {"clock": dict(recording.clock), "refused": None, "lost": lost, "problems": []})
    return told


def _read(path: Path, of: Vehicle, commands: Path | None, allow_partial: bool) -> Recording:
    from bcid.recording.read import read_recording

    try:
        return read_recording(path, of, commands, allow_partial)
    except OSError as error:
        cause = f"cannot be read: {error.strerror or error}"
        raise InputRefused(path, "file", cause, "check the path and who may read it") from None


def report(told: list[dict[str, Any]], sink: Sink) -> None:
    """Print them.

    Raises:
        InputRefused: what is wrong with those that are refused, after all have been told.
        PartLost: a part of one could not be read, as was allowed.
    """
    from bcid.cli import show

    sink.result({"schema": "bcid.health/1", "recordings": told}, lambda: show.health(told))
    Problems(Problem(**p) for t in told for p in t["problems"]).refuse("recordings")
    lost = [t["recording"] for t in told if t["lost"]]
    if lost:
        raise PartLost(f"a part is lost: {', '.join(lost)}\n  next: repair or record it again")

"""`bcid ingest --check`: the health of recordings, all of them, whatever is wrong with some."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bcid.cli.options import plan_of
from bcid.cli.sink import Sink
from bcid.errors import BcidError, InputRefused, PartLost, UsageError
from bcid.vehicle import read_vehicle


def checked(
    pipeline: Path | None,
    recordings: list[Path] | None,
    vehicle: Path | None,
    commands: Path | None,
    allow_partial: bool,
) -> list[dict[str, Any]]:
    """Of each recording its health, or why it is refused."""
    from bcid.recording.formats import commands_of
    from bcid.recording.health import health
    from bcid.recording.read import read_recording

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
            recording = read_recording(path, of, commands_of(path, commands), allow_partial)
        except (InputRefused, OSError) as error:
            problems = error.problems if isinstance(error, InputRefused) else ()
            why = "; ".join(f"{p.place}: {p.cause}" for p in problems) or str(error)
            no = {"go": False, "sentence": f"no-go: refused, {why}", "refused": str(error), "lost": False}
            told.append(row | no | {"problems": [p._asdict() for p in problems]})
            continue
        lost = any(i.kind == "lost" for i in recording.irregularities)
        found = health(recording, of).as_json()
        told.append(row | found | {"clock": dict(recording.clock), "refused": None, "lost": lost, "problems": []})
    return told


def report(told: list[dict[str, Any]], sink: Sink) -> None:
    """Print them.

    Raises:
        Refused: what is wrong with those that are refused, after all have been told.
        PartLost: a part of one could not be read, as was allowed.
    """
    from bcid.cli import show

    sink.result({"schema": "bcid.health/1", "recordings": told}, lambda: show.health(told))
    refused = [t["refused"] for t in told if t["refused"]]
    if refused:
        raise Refused("\n".join(refused))
    lost = [t["recording"] for t in told if t["lost"]]
    if lost:
        raise PartLost(f"a part is lost: {', '.join(lost)}\n  next: repair or record it again")


class Refused(BcidError):
    """Several refusals as one message."""

    exit_code = InputRefused.exit_code

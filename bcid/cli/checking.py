"""`bcid ingest --check`: the health of recordings, all of them, whatever is wrong with some."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bcid.cli.options import plan_of
from bcid.cli.sink import Sink
from bcid.errors import InputRefused, UsageError
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

    if recordings:
        if vehicle is None and pipeline is None:
            raise UsageError("recordings need --vehicle VEHICLE.toml\n  next: `bcid init` writes one")
        of = read_vehicle(vehicle or plan_of(pipeline).vehicle)
        paths = recordings
    else:
        plan = plan_of(pipeline)
        of, paths = read_vehicle(plan.vehicle), [*plan.training, *([plan.validation] if plan.validation else [])]
    told = []
    for path in paths:
        row: dict[str, Any] = {"recording": str(path)}
        try:
            recording = read_recording(path, of, commands_of(path, commands), allow_partial)
        except InputRefused as error:
            told.append(
                row | {"go": False, "sentence": f"no-go: refused, {error.place}: {error.cause}", "refused": str(error)}
            )
            continue
        told.append(row | health(recording, of).as_json() | {"clock": dict(recording.clock), "refused": None})
    return told


def report(told: list[dict[str, Any]], sink: Sink) -> None:
    """Print them.

    Raises:
        InputRefused: the first of those that are refused, after all have been told.
    """
    from bcid.cli import show

    sink.result({"schema": "bcid.health/1", "recordings": told}, lambda: show.health(told))
    refused = [t["refused"] for t in told if t["refused"]]
    if refused:
        raise Refused("\n".join(refused))


class Refused(InputRefused):
    """Several refusals as one message."""

    def __init__(self, text: str) -> None:
        Exception.__init__(self, text)

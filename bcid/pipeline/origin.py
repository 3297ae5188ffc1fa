"""Where a result comes from, traced for its card: the vehicle file, the recordings and the command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bcid.pipeline.take_stages import TakeStages
from bcid.store.artifact import file_sha256

if TYPE_CHECKING:
    from bcid.pipeline.model_card import Origin


def trace_origin(takes: TakeStages, recordings: Sequence[Path]) -> Origin:
    """Where a result that was made from these `recordings` comes from, for its card."""
    from bcid.documents.model_card import DataFile
    from bcid.pipeline.model_card import IngestedTake, Origin
    from bcid.recording.cuts import split_cut
    from bcid.recording.recorded_on import recorded_on

    runner = takes.runner
    file = runner.config.vehicle
    vehicle_file = DataFile(name=file.name, sha256=file_sha256(file), format="toml")
    taken = [
        IngestedTake(takes.ingest(p).folder, takes.title(p).removesuffix(p.name), recorded_on(split_cut(p)[0]))
        for p in recordings
    ]
    return Origin(runner.vehicle.name, vehicle_file, taken, runner.config.command)


def origin_key(origin: Origin) -> dict[str, Any]:
    """What of an origin counts in the key of what is made from it: the content of files, and dates in them."""
    takes = [[take.parents, take.recorded] for take in origin.recordings]
    return {"vehicle_file": [origin.vehicle_file.name, origin.vehicle_file.sha256], "recorded": takes}

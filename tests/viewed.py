"""Views read back by mcap's own reader, and a workspace with a diagnosis that took no time to make."""

from __future__ import annotations

import json
import shutil
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from exported_models import CAR, Constants
from mcap.reader import make_reader

from bcid.diagnosis.summary import KNOT_UNITS
from bcid.documents.diagnosis import BaseModel, BaseParameter, DiagnosisDocument, HorizonError, NamedEffect, Quantity
from bcid.estimate.saving import save_estimate
from bcid.estimate.types import Estimate
from bcid.files.parquet import write_columns
from bcid.files.source_code import StageCode
from bcid.likelihood.take import KNOT_S
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.saving import save_model
from bcid.recording.saving import save_recording
from bcid.recording.types import Recording
from bcid.store.artifact import Artifact, Recipe, Store
from bcid.vehicle import Vehicle

CODE = StageCode("code", {})
WORST_S = 20.125  # the middle of a knot
"""The middle of the knot at which the made diagnosis helps most."""


class Read(NamedTuple):
    """A message as it stands in a file."""

    log_ns: int
    publish_ns: int
    schema: str
    message: Any


def read_view(path: Path) -> dict[str, list[Read]]:
    """The messages of every topic; checksums are verified."""
    topics = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            read = Read(message.log_time, message.publish_time, schema.name, json.loads(message.data))
            topics[channel.topic].append(read)
    return dict(topics)


def stamp_ns(message: Any) -> int:
    """The stamp in a message."""
    return int(message["timestamp"]["sec"]) * 1_000_000_000 + int(message["timestamp"]["nsec"])


def miss_m(topics: dict[str, list[Read]], name: str) -> float:
    """Root mean square distance (m) of a model's predicted places from the measured ones."""
    tables = [
        np.array([[read.log_ns * 1e-9, *(read.message["pose"]["position"][c] for c in "xy")] for read in topics[topic]])
        for topic in ("/bcid/measured/pose", f"/bcid/{name}/pose")
    ]
    (t, x, y), (at, p_x, p_y) = (table.T for table in tables)
    return float(np.sqrt(np.mean((np.interp(at, t, x) - p_x) ** 2 + (np.interp(at, t, y) - p_y) ** 2)))


def patch_found(x: float, y: float) -> DiagnosisDocument:
    """A diagnosis that names a rough patch around (x, y), and has all kinds of tables."""
    patch = {
        "b": Quantity(value=30.39, se=0.22, unit="N s/m"), "x": Quantity(value=x, se=0.002, unit="m"),
        "y": Quantity(value=y, se=0.004, unit="m"), "radius": Quantity(value=1.2, se=0.003, unit="m"),
    }  # fmt: skip
    return DiagnosisDocument(
        kind="bcid.diagnosis/2", vehicle="bumper-car", recordings=("drive",), verdict="named",
        findings=(NamedEffect(effect="rough_patch", kind="environment", probability=1.0, parameters=patch),),
        horizons=(HorizonError(horizon_s=0.5, nmse_before=1e-3, nmse_after=1e-4, before_ci95=(9e-4, 2e-3)),),
        base=BaseModel(parameters=(BaseParameter(symbol="C_f", value=3594.0, se=118.0, unit="N/rad"),)),
    )  # fmt: skip


def made_knots(estimates: Sequence[Estimate], durations_s: Sequence[float]) -> Any:
    """Knots along the paths of takes that follow each other after a second, with a push to the left at WORST_S."""
    rows, ahead = [], 0.0
    for e, duration_s in zip(estimates, durations_s, strict=True):
        time_s = np.arange(5.0 + 0.5 * KNOT_S, duration_s - 5.0, KNOT_S)
        pose = np.column_stack([np.interp(time_s, e.time_s, column) for column in e.pose.T])
        knots = np.zeros((len(time_s), len(KNOT_UNITS)))
        names = list(KNOT_UNITS)
        knots[:, names.index("time_s")] = ahead + time_s
        knots[:, names.index("x") : names.index("heading") + 1] = pose
        knots[:, names.index("before_fx")] = -0.1
        knots[:, names.index("after_fx")] = -0.02
        knots[time_s == WORST_S, names.index("before_fx")] = -2.0
        knots[time_s == WORST_S, names.index("before_mz")] = 0.5
        rows.append(knots)
        ahead += duration_s + 1.0
    return np.vstack(rows)


def made_workspace(
    folder: Path, recordings: Sequence[Recording], estimates: Sequence[Estimate], vehicle: Vehicle
) -> Path:
    """A workspace in which takes were ingested, estimated and diagnosed, as far as a view reads it."""
    store = Store(folder)

    def made(stage: str, number: int, write: Any, **inputs: Any) -> Artifact:
        return store.get_or_make(Recipe(stage, {"number": number, **inputs}, {}, CODE), write)

    pairs = [
        (
            made("ingest", n, partial(save_recording, recording)),
            made("estimate", n, partial(save_estimate, estimate)),
        )
        for n, (recording, estimate) in enumerate(zip(recordings, estimates, strict=True))
    ]
    x, y = (float(np.interp(WORST_S, estimates[0].time_s, estimates[0].pose[:, c])) for c in (0, 1))

    def diagnose(into: Path) -> None:
        patch_found(x, y).write(into / "diagnosis.json")
        write_columns(into / "knots.parquet", made_knots(estimates, [r.duration_s for r in recordings]), KNOT_UNITS)
        for name, effects in (("base", {}), ("model", {"rear_rolling_viscous__b": 11.0})):
            (into / name).mkdir()
            model = AugmentedNewtonEuler(CAR, effects, Constants(), 1.2, 60.0, estimates[0].period_s, {})
            save_model(model, into / name)

    kept = vehicle.model_dump(mode="json", by_alias=True, include={"name", "body", "steering", "motor"})
    takes, names = [[a.content for a in pair] for pair in pairs], [r.name for r in recordings]
    diagnosed = made("diagnose", 0, diagnose, takes=takes, names=names, vehicle=kept)
    (folder / "diagnosis").mkdir()
    shutil.copy(diagnosed.folder / "diagnosis.json", folder / "diagnosis")
    return folder

"""The view of a diagnosed take, from what a workspace holds: recording, motion, both models, pushes, the verdict."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from bcid.aliases import Floats
from bcid.diagnosis.summary import KNOT_UNITS
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.manifest import ManifestDocument
from bcid.errors import InputRefused, UsageError
from bcid.estimate.saving import load_estimate
from bcid.estimate.types import Estimate
from bcid.files.parquet import read_columns
from bcid.models.saving import load_model, model_digest
from bcid.recording.formats.detect import recording_files
from bcid.recording.saving import RecordingSummary, load_recording
from bcid.recording.types import Recording
from bcid.store.artifact import MANIFEST, Artifact, file_sha256
from bcid.vehicle import Vehicle, read_vehicle
from bcid.view.content import Attachment, Diagnosed, ViewContent, earliest_zero_ns, predict_windows
from bcid.view.stamps import zero_stamp_ns

DOCUMENT = "diagnosis.json"
MODEL_FOLDERS = {"before": "base", "after": "model"}
DIAGNOSE = "diagnose there, with `bcid diagnose` or `bcid run`"

GAP_S = 1.0
"""The pause (s) between takes that are diagnosed together, on the one clock of their knots: see `concatenate_takes`."""
MAX_ASIDE_WHEELBASES = 1.0
"""Median distance of a take's knots from its path beyond which they are another take's."""


class DiagnosedTake(NamedTuple):
    """One of the takes of a diagnosis: its number there, its name, and the artifacts of its recording and motion."""

    number: int
    name: str
    recording: Path
    estimate: Path


def is_workspace(path: Path) -> bool:
    """Whether `path` is a folder that bcid has worked in, and no recording, which may be a folder as well."""
    return path.is_dir() and any((path / stage).is_dir() for stage in ("ingest", "diagnose", "report", "diagnosis"))


def view_of_workspace(
    workspace: Path, take: str | None = None, vehicle_path: Path | None = None, allow_partial: bool = False
) -> ViewContent:
    """The view of a take that was diagnosed in a workspace.

    `take` is its name in the diagnosis, or the recorded file itself, whose stamps are kept then; times count from the
    take's start otherwise.  It is the first take unless named.  The vehicle file is needed for those stamps only, and
    is attached where it is given.

    Raises:
        InputRefused: there is no diagnosis, or what belongs to it is missing or damaged.
    """
    folder = find_diagnosis(workspace)
    manifest, document = ManifestDocument.read(folder / MANIFEST), DiagnosisDocument.read(folder / DOCUMENT)
    takes = _diagnosed_takes(workspace, manifest)
    chosen = _choose_take(takes, take)
    recording, estimate = load_recording(chosen.recording), load_estimate(chosen.estimate)
    vehicle = read_vehicle(vehicle_path) if vehicle_path else _kept_vehicle(folder, manifest)
    zero_ns = earliest_zero_ns(recording)
    if take is not None and take != chosen.name:
        if vehicle_path is None:
            raise UsageError(f"the stamps of {take} are read by its vehicle file\n  next: add --vehicle VEHICLE.toml")
        zero_ns = zero_stamp_ns(Path(take), vehicle, recording, allow_partial)
    models = {stage: folder / name for stage, name in MODEL_FOLDERS.items()}
    facts = {f"{stage} model sha256": model_digest(path) for stage, path in models.items()}
    facts |= {"diagnosis artifact": folder.name, "diagnosis sha256": file_sha256(folder / DOCUMENT)}
    attached = [Attachment(DOCUMENT, "application/json", (folder / DOCUMENT).read_bytes())]
    if vehicle_path:
        facts["vehicle sha256"] = file_sha256(vehicle_path)
        attached.append(Attachment(vehicle_path.name, "application/toml", vehicle_path.read_bytes()))
    return ViewContent(
        recording, estimate, vehicle, zero_ns,
        {stage: predict_windows(load_model(path), estimate) for stage, path in models.items()},
        Diagnosed(document, _take_knots(folder, takes, chosen, recording, estimate, vehicle)), tuple(attached), facts,
    )  # fmt: skip


def find_diagnosis(workspace: Path) -> Path:
    """The artifact of the diagnosis that lies open in a workspace, with both models.

    Raises:
        InputRefused: there is none, it was edited, or an earlier bcid made it, which kept no base model.
    """
    published = find_document(workspace, "diagnosis", DOCUMENT)
    if published is None:
        raise InputRefused(workspace, "diagnosis", f"holds no {DOCUMENT}", DIAGNOSE)
    digest = file_sha256(published)
    made = [path.parent for path in sorted(workspace.glob(f"diagnose/*/{DOCUMENT}")) if file_sha256(path) == digest]
    if not made:
        raise InputRefused(
            published, "file", "is none that was made in this workspace: it was edited, or moved", DIAGNOSE
        )
    whole = [folder for folder in made if all((folder / name).is_dir() for name in MODEL_FOLDERS.values())]
    if not whole:
        cause = "was made by an earlier bcid, which kept no base model to predict with"
        raise InputRefused(made[0], MODEL_FOLDERS["before"], cause, DIAGNOSE)
    return whole[0]


def find_document(workspace: Path, stage: str, name: str) -> Path | None:
    """The document that a command left in a workspace: in the folder of its stage, or beside it; None without one."""
    return next((path for path in (workspace / stage / name, workspace / name) if path.is_file()), None)


def _kept_vehicle(folder: Path, manifest: ManifestDocument) -> Vehicle:
    """The vehicle as far as a diagnosis depends on it, by the manifest of its artifact."""
    try:
        return Vehicle.model_validate(manifest.inputs.get("vehicle"))
    except ValidationError:
        raise InputRefused(folder / MANIFEST, "vehicle", "is no vehicle", DIAGNOSE) from None


def _diagnosed_takes(workspace: Path, manifest: ManifestDocument) -> list[DiagnosedTake]:
    """The takes of a diagnosis, by the digests of their content in its manifest."""
    contents: Mapping[str, dict[str, Path]] = {
        stage: {Artifact(f, f.name, True).content: f for f in sorted((workspace / stage).glob("*")) if f.is_dir()}
        for stage in ("ingest", "estimate")
    }
    takes = []
    for number, (name, pair) in enumerate(zip(manifest.inputs["names"], manifest.inputs["takes"], strict=True)):
        folders = [contents[stage].get(content) for stage, content in zip(contents, pair, strict=True)]
        if None in folders:
            raise InputRefused(workspace, f"take {name}", "its artifacts are not in this workspace any more", DIAGNOSE)
        takes.append(DiagnosedTake(number, name, *(f for f in folders if f is not None)))
    return takes


def _choose_take(takes: Sequence[DiagnosedTake], wanted: str | None) -> DiagnosedTake:
    """The take called `wanted`, or the one that was read from the file `wanted`; the first where it is None.

    Raises:
        UsageError: there is no such take.
    """
    if wanted is None:
        return takes[0]
    named = [t for t in takes if t.name == wanted]
    if not named and Path(wanted).exists():
        digests = {file_sha256(part) for part in recording_files(Path(wanted))}
        named = [t for t in takes if digests & {s.sha256 for s in _summary(t).sources}]
    if not named:
        names = ", ".join(t.name for t in takes)
        raise UsageError(f"the diagnosis has no take {wanted!r}\n  next: name one of {names}, or its recorded file")
    return named[0]


def _summary(take: DiagnosedTake) -> RecordingSummary:
    """What is known of a take's recording besides its samples."""
    return RecordingSummary.read(take.recording / "recording.json")


def _take_knots(
    folder: Path, takes: Sequence[DiagnosedTake], chosen: DiagnosedTake, recording: Recording, estimate: Estimate,
    vehicle: Vehicle,
) -> dict[str, Floats]:  # fmt: skip
    """The columns (K,) of the knots of one take, their times on its recording's clock.

    Takes that are diagnosed together lie one after the other on one clock, to within an integration step (0.025 s).

    Raises:
        InputRefused: no knots lie on the take's path, since none of its stretches was diagnosed.
    """
    columns = dict(zip(KNOT_UNITS, read_columns(folder / "knots.parquet", KNOT_UNITS).T, strict=True))
    lengths = [_summary(t).duration_s for t in takes]
    begin = math.fsum(lengths[: chosen.number]) + GAP_S * chosen.number
    own = (columns["time_s"] >= begin) & (columns["time_s"] <= begin + lengths[chosen.number] + 0.5 * GAP_S)
    knots = {name: column[own] for name, column in columns.items()}
    knots["time_s"] = knots["time_s"] - begin + float(recording.poses.time_s[0])
    x, y = (np.interp(knots["time_s"], estimate.time_s, estimate.pose[:, c]) for c in (0, 1))
    aside = np.hypot(knots["x"] - x, knots["y"] - y)
    if not len(aside) or np.median(aside) > MAX_ASIDE_WHEELBASES * vehicle.body.wheelbase_m:
        cause = f"none of its stretches was diagnosed, or they cannot be told from other takes' ({chosen.name})"
        raise InputRefused(folder, "knots.parquet", cause, "view another take with --take")
    return knots

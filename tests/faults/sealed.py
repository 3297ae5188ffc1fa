"""Kinds of files whose mutants get behind the checksums: every digest of what was changed is made right again.

What is read of them is used: models are driven, recordings estimated.  What comes of it may be other values, since
nothing says that they are wrong, but no traceback, no hang and nothing that is not a finite number.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import io
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from making import circling_take

from bcid.errors import InputRefused
from bcid.estimate.run import estimate_motion
from bcid.evaluation.validity import load_validity
from bcid.files.source_code import StageCode
from bcid.models.interface import RolloutDiverged, history_at_rest, rollout
from bcid.models.saving import load_model, save_model
from bcid.pipeline.config import read_pipeline_file
from bcid.recording.read import read_recording
from bcid.recording.saving import load_recording, save_recording
from bcid.recording.types import Recording
from bcid.simulation.samples import VEHICLE
from bcid.store.artifact import Recipe, Store
from bcid.vehicle import Vehicle, read_vehicle
from faults.edits import RAW, VALUES, paths_of
from faults.mutants import BYTES, TEXT, Mutator, Rng
from faults.saved import TUNING, models, seal_model, sealed_text
from faults.specimens import Specimen, seen

STEPS = 20
RECIPE = Recipe("ingest", {"take": "1"}, {}, StageCode("c0de", {"numpy": "2"}))
ODD_TOML = (
    "nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "5e-324", "1e400", "true", '""', '"text"', '"0_1.5"', "[]",
    "[1]", "[1.0, 2.0]", "{}", "{a = 1}", "2026-01-01", "07:30:00", "0x10", "1_000", "9" * 400, "9" * 5000,
    "[" * 500 + "]" * 500, r'"\u0000"', r'"\u001b[31m"', '"../../x"', '"/dev/zero"', f'"{"x" * 5000}"', "115",
    "319600", "1e-9",
)  # fmt: skip


def sealed_specimens(folder: Path, recording: Recording, vehicle: Vehicle) -> list[Specimen]:
    """All such kinds, their clean files written under `folder`."""
    home = folder / "sealed"
    home.mkdir()
    return [*_models(home), *_artifacts(home, recording, vehicle), *_settings(home), *_partly(home, vehicle)]


def edit_json(data: bytes, rng: Rng) -> bytes:
    """One field of a JSON object, or several."""
    content, raw = json.loads(data), dict[str, str]()
    for k in range(int(rng.integers(1, 4))):
        paths = [p for p in paths_of(content) if p[0] != "sha256"]
        if not paths:
            break
        *way, last = paths[int(rng.integers(len(paths)))]
        container = content
        for key in way:
            container = container[key]
        how = int(rng.integers(len(VALUES) + len(RAW) + 2))
        if how == 0:
            del container[last]
        elif how == 1:
            container[last] = [container[last], copy.deepcopy(container[last])]
        elif how < 2 + len(VALUES):
            container[last] = copy.deepcopy(list(VALUES.values())[how - 2])
        else:
            container[last] = f"@raw{k}@"
            raw[f'"@raw{k}@"'] = list(RAW.values())[how - 2 - len(VALUES)]
    return sealed_text(content, raw).encode()


def text_of_json(data: bytes, rng: Rng) -> bytes:
    """Bytes of a JSON file, the digest made right where it is one still."""
    mutated = TEXT[int(rng.integers(len(TEXT)))](data, rng)
    with contextlib.suppress(ValueError, RecursionError):
        content = json.loads(mutated)
        if isinstance(content, dict):
            return sealed_text(content, {}).encode()
    return mutated


def toml_value(data: bytes, rng: Rng) -> bytes:
    """The values of one to three keys of a TOML file, of any type."""
    lines = data.decode().splitlines()
    keys = [i for i, line in enumerate(lines) if "=" in line and not line.startswith("#")]
    for _ in range(int(rng.integers(1, 4))):
        i = keys[int(rng.integers(len(keys)))]
        lines[i] = f"{lines[i].split('=')[0]}= {ODD_TOML[int(rng.integers(len(ODD_TOML)))]}"
    return "\n".join(lines).encode()


def table_values(data: bytes, rng: Rng) -> bytes:
    """A Parquet table with other values, types, names or rows, with page checksums that are right."""
    table = pq.read_table(io.BytesIO(data))
    at = int(rng.integers(table.num_columns))
    name, n = table.column_names[at], len(table)
    numbers = table[name].to_numpy().copy()
    how = int(rng.integers(8))
    if how < 3:
        rows = rng.integers(n, size=int(rng.integers(1, n)))
        odd = (np.nan, np.inf, -1.0, 0.0, 1e308, -1e308, 1e15, 5e-324, numbers[0])
        numbers[rows] = odd[int(rng.integers(len(odd)))]
        table = table.set_column(at, name, pa.array(numbers))
    elif how == 3:
        kinds = (pa.float32(), pa.int64(), pa.string(), pa.float16(), pa.timestamp("ns"), pa.binary(), pa.bool_())
        values = pa.array([str(v) for v in numbers]) if rng.random() < 0.5 else pa.array(np.arange(n))
        with contextlib.suppress(pa.ArrowException):
            values = values.cast(kinds[int(rng.integers(len(kinds)))])
        table = table.set_column(at, name, values.dictionary_encode() if rng.random() < 0.3 else values)
    elif how == 4:
        table = table.rename_columns([c if c != name else f"{c} " for c in table.column_names])
    elif how == 5:
        table = table.append_column(name, table[name])
    elif how == 6:
        table = table.take(pa.array(rng.permutation(n)[: int(rng.integers(n + 1))]))
    else:
        hidden = pa.array(rng.random(n) < 0.5)
        table = table.set_column(at, name, pa.array(numbers, mask=hidden.to_numpy(zero_copy_only=False)))
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd", write_page_checksum=True)
    return out.getvalue()


def _models(home: Path) -> list[Specimen]:
    """A model with equations and network, and one with effects: JSON and arrays."""
    found = []
    for name in ("k-sindy-mlp", "newton-euler-augmented", "narx-mlp"):
        folder = home / name
        folder.mkdir()
        save_model(models()[name], folder)
        read = partial(_drive, folder)
        mutators: tuple[Mutator, ...] = (edit_json, edit_json, text_of_json)
        found.append(Specimen(f"{name}'s model.json, digest right", folder / "model.json", read, mutators, False))
        if (folder / "arrays.safetensors").exists():
            path = folder / "arrays.safetensors"
            again = partial(_reseal_arrays, folder, read)
            found.append(Specimen(f"{name}'s arrays, digest right", path, again, BYTES, False))
    return found


def _reseal_arrays(folder: Path, read: Callable[[], Any]) -> Any:
    """What `read` gives after model.json was told the digest of the arrays as they are."""
    data = json.loads((folder / "model.json").read_text())
    data["arrays_sha256"] = hashlib.sha256((folder / "arrays.safetensors").read_bytes()).hexdigest()
    seal_model(folder / "model.json", data, {})
    return read()


def _drive(folder: Path) -> Any:
    model, _ = load_model(folder), load_validity(folder)
    commands = np.tile([0.2, 1.0], (STEPS, 1))
    model.describe()
    try:
        twist = rollout(model, history_at_rest(model.lags), commands)
    except RolloutDiverged as error:
        raise InputRefused(folder, "model.json", str(error), "drive it more gently") from None
    if not np.isfinite(twist).all():
        raise FloatingPointError("not finite")
    return {"twist": twist}


def _artifacts(home: Path, recording: Recording, vehicle: Vehicle) -> list[Specimen]:
    """A workspace's artifact, whose manifest is told the digests of the files as they are."""
    store = Store(home / "workspace")
    made = store.get_or_make(RECIPE, partial(save_recording, recording)).folder
    pages = made / "commands.parquet"
    pq.write_table(pq.read_table(pages), pages, compression="none", use_dictionary=False)  # without page checksums

    def again(folder: Path) -> None:
        raise InputRefused(folder, "artifact", "is not as it was written", "it is made anew")

    def read() -> Any:
        manifest = json.loads((made / "manifest.json").read_text())
        manifest["files"] = {n: hashlib.sha256((made / n).read_bytes()).hexdigest() for n in manifest["files"]}
        (made / "manifest.json").write_text(json.dumps(manifest))
        taken = load_recording(store.get_or_make(RECIPE, again).folder)
        motion = estimate_motion(taken, vehicle, TUNING)
        if not np.isfinite(motion.twist).all():
            raise FloatingPointError("not finite")
        return {"twist": motion.twist}

    return [
        Specimen(f"artifact's {name}, digest right", made / name, read, mutators, False)
        for name, mutators in (
            ("recording.json", (edit_json, edit_json, *TEXT)),
            ("poses.parquet", (table_values, table_values, *BYTES)), ("commands.parquet", BYTES),
        )
    ]  # fmt: skip


def _settings(home: Path) -> list[Specimen]:
    """Vehicle and pipeline files with values of other types and sizes."""
    (home / "car.toml").write_text(VEHICLE)
    pipeline = home / "pipeline.toml"
    pipeline.write_bytes((Path(__file__).parents[2] / "pipelines" / "bumper_car.toml").read_bytes())
    mutators = (toml_value, toml_value, *TEXT)
    return [
        Specimen("vehicle TOML, values", home / "car.toml", partial(read_vehicle, home / "car.toml"), mutators, False),
        Specimen("pipeline TOML, values", pipeline, partial(read_pipeline_file, pipeline), mutators, False),
    ]


def _partly(home: Path, vehicle: Vehicle) -> list[Specimen]:
    """A Motive export and its commands, read with what a damaged recording still holds (--allow-partial)."""
    path = circling_take(home, "partly", 8.0)

    def read() -> Any:
        return seen(read_recording(path, vehicle, allow_partial=True))

    return [
        Specimen("Motive CSV, what can be read of it", path, read, TEXT, False),
        Specimen("commands CSV, what can be read", path.with_suffix(".commands.csv"), read, TEXT, False),
    ]

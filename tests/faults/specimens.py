"""One small clean file of every kind, how it is read, and what must come of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from making import circling_take
from mcap.writer import CompressionType, Writer
from test_readers import as_ros2, topical

from bcid.errors import InputRefused
from bcid.files.source_code import StageCode
from bcid.recording.read import read_recording
from bcid.recording.saving import load_recording, save_recording
from bcid.recording.types import Recording
from bcid.simulation.samples import VEHICLE
from bcid.store.artifact import Recipe, Store
from bcid.vehicle import Vehicle, read_vehicle
from faults.mcap_mutants import DEFINITIONS, REPAIRED, in_metadata
from faults.mcap_specimens import as_protobuf, as_single_numbers
from faults.mutants import BYTES, TEXT, Mutator

SOUND = 1e11  # finite, and no more seconds, metres or radians than a limit lets through
START_NS = 1_700_000_000_000_000_000
METADATA = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  compression_format: ''
  relative_file_paths:
    - bag_0.mcap
  files:
    - path: bag_0.mcap
"""
COLUMNS = {"time_s": "t", "x_m": "px", "y_m": "py", "yaw_rad": "psi", "steering_rad": "steer", "throttle_mps": "gas"}


@dataclass(frozen=True)
class Specimen:
    """A kind of file."""

    name: str
    path: Path  # of the file that is mutated
    read: Callable[[], Any]  # what comes of it; raises BcidError where it is refused
    mutators: tuple[Mutator, ...]
    verified: bool  # its bytes are vouched for: whatever is read must be what was written
    salvaged: bool = False  # with --allow-partial: what is vouched for must be a part of what was written


def seen(recording: Recording) -> dict[str, Any]:
    """What must not change, and what has been told of it."""
    digest, streams = hashlib.sha256(), (recording.poses, recording.commands)
    for stream in (*streams, *recording.channels.values()):
        digest.update(stream.time_s.tobytes() + stream.values.tobytes())
    # how many messages no checksum covers is no word on those that are lost
    told = sorted((i.kind, i.action, i.count) for i in recording.irregularities if i.kind != "integrity")
    # behind what is lost, nobody knows how often the car has turned
    rows = {(k, row[:2].tobytes()) for k, stream in enumerate(streams) for row in stream.values}
    vouched = not any(i.kind == "integrity" for i in recording.irregularities)
    values = [x for stream in (*streams, *recording.channels.values()) for x in (stream.time_s, stream.values)]
    return {
        "sound": all(bool((np.abs(x) < SOUND).all()) for x in values),
        "vouched": vouched,
        "content": digest.hexdigest(),
        "samples": sum(map(len, streams)),
        "told": told,
        "rows": rows,
    }


def specimens(folder: Path) -> list[Specimen]:
    """All kinds, their clean files written under `folder`."""
    (folder / "car.toml").write_text(VEHICLE)
    vehicle = read_vehicle(folder / "car.toml")
    motive = circling_take(folder, "drive", 8.0)
    clean = read_recording(motive, vehicle)

    def recorded(path: Path, car: Vehicle = vehicle, salvage: bool = False) -> Callable[[], Any]:
        return lambda: seen(read_recording(path, car, allow_partial=salvage))

    found = [
        Specimen("Motive CSV", motive, recorded(motive), TEXT, False),
        Specimen("commands CSV", motive.with_suffix(".commands.csv"), recorded(motive), TEXT, False),
    ]
    tabled = Vehicle.model_validate({**vehicle.model_dump(by_alias=True), "columns": COLUMNS})
    table = _table(clean)
    table.to_csv(folder / "table.csv", index=False)
    found.append(Specimen("table CSV", folder / "table.csv", recorded(folder / "table.csv", tabled), TEXT, False))
    table.to_parquet(folder / "table.parquet")
    path = folder / "table.parquet"
    found.append(Specimen("table Parquet", path, recorded(path, tabled), BYTES, False))
    for kind, options in {
        "zstd": {}, "lz4": {"compression": CompressionType.LZ4}, "none": {"compression": CompressionType.NONE},
        "unchunked": {"use_chunking": False, "enable_data_crcs": True}, "no checksums": {"enable_crcs": False},
    }.items():  # fmt: skip
        path = _mcap(folder / f"{kind.replace(' ', '_')}.mcap", clean, **options)
        found.append(Specimen(f"MCAP {kind}", path, recorded(path), BYTES, kind != "no checksums"))
        if kind in ("zstd", "unchunked"):
            read = recorded(path, salvage=True)
            found.append(Specimen(f"MCAP {kind}, salvaged", path, read, BYTES, False, salvaged=True))
    for name, kind in (("poses", "geometry_msgs/msg/PoseStamped"), ("transforms", "tf2_msgs/msg/TFMessage")):
        (folder / name).mkdir()
        path = as_ros2(clean, folder / name, kind, compression=CompressionType.NONE, enable_crcs=False)
        found.append(Specimen(f"MCAP CDR {name}, no checksums", path, recorded(path, topical(vehicle)), BYTES, False))
    found += _repaired(folder, clean, vehicle)
    from faults.sealed import sealed_specimens

    return [*found, *_own(folder), *_kept(folder, clean), *sealed_specimens(folder, clean, vehicle)]


def _repaired(folder: Path, clean: Recording, vehicle: Vehicle) -> list[Specimen]:
    """MCAP files that are changed behind their checksums, in messages and in definitions, and the folder of a bag."""
    ros, found = topical(vehicle), []
    proto = folder / "proto.mcap"
    as_protobuf(clean, proto)
    singles = as_single_numbers(clean, folder / "singles.mcap")
    two = topical(vehicle, command={"steering": "/steering", "throttle": "/throttle"})
    json_file = _mcap(folder / "json.mcap", clean)
    sources = {"JSON": (json_file, vehicle), "protobuf": (proto, ros), "single numbers": (singles, two)}
    for name, kind in (("poses", "geometry_msgs/msg/PoseStamped"), ("bodies", "mocap4r2_msgs/msg/RigidBodies"),
                       ("transforms", "tf2_msgs/msg/TFMessage")):  # fmt: skip
        (folder / f"cdr_{name}").mkdir()
        sources[f"CDR {name}"] = as_ros2(clean, folder / f"cdr_{name}", kind), ros
    for name, (path, car) in sources.items():
        for how, mutators in (("repaired", REPAIRED), ("definitions", DEFINITIONS)):
            for salvage in (False, True):
                kind = f"MCAP {name}, {how}{', salvaged' if salvage else ''}"
                found.append(Specimen(kind, path, partial(_seen_of, path, car, salvage), mutators, False))
    bag = folder / "bag"
    bag.mkdir()
    _mcap(bag / "bag_0.mcap", clean)
    (bag / "metadata.yaml").write_text(METADATA)
    found.append(
        Specimen(
            "bag metadata.yaml",
            bag / "metadata.yaml",
            partial(_seen_of, bag, vehicle, False),
            (*TEXT, in_metadata, in_metadata),
            False,
        )
    )
    return found


def _seen_of(path: Path, vehicle: Vehicle, salvage: bool) -> dict[str, Any]:
    """What is seen of the recording at `path`."""
    return seen(read_recording(path, vehicle, allow_partial=salvage))


def _table(recording: Recording) -> pd.DataFrame:
    t, pose = recording.poses.time_s, recording.poses.values
    rows = np.searchsorted(recording.commands.time_s, t, side="right") - 1
    u_s, u_m = recording.commands.values[np.maximum(rows, 0)].T
    return pd.DataFrame({"t": t, "px": pose[:, 0], "py": pose[:, 1], "psi": pose[:, 2], "steer": u_s, "gas": u_m})


def _mcap(path: Path, recording: Recording, **options: Any) -> Path:
    """The recording as JSON messages."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=20_000, **{"compression": CompressionType.ZSTD, **options})
        writer.start()
        schema = writer.register_schema("foxglove.PoseInFrame", "jsonschema", b"{}")
        pose = writer.register_channel("/mocap/bumper_car/pose", "json", schema)
        schema = writer.register_schema("bcid.Command", "jsonschema", b"{}")
        command = writer.register_channel("/bumper_car/command", "json", schema)
        rows = [(t, pose, _pose(t, p)) for t, p in zip(recording.poses.time_s, recording.poses.values, strict=True)]
        rows += [
            (t, command, {"timestamp": _stamp(t), "steering_rad": s, "throttle_mps": m})
            for t, (s, m) in zip(recording.commands.time_s, recording.commands.values, strict=True)
        ]
        for t, channel, message in sorted(rows, key=lambda row: row[:2]):
            ns = START_NS + round(t * 1e9)
            writer.add_message(channel, ns, json.dumps(message).encode(), ns)
        writer.finish()
    return path


def _stamp(t: float) -> dict[str, int]:
    ns = START_NS + round(t * 1e9)
    return {"sec": ns // 10**9, "nsec": ns % 10**9}


def _pose(t: float, pose: np.ndarray) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(pose[2] / 2)), "w": float(np.cos(pose[2] / 2))}
    where = {"x": float(pose[0]), "y": float(pose[1]), "z": 0.3}
    return {"timestamp": _stamp(t), "pose": {"position": where, "orientation": turn}}


def _own(folder: Path) -> list[Specimen]:
    """What bcid itself writes, and the TOML files that it reads."""
    from bcid.models import published
    from bcid.models.kinematic.k_mlp import KMlp
    from bcid.models.network.mlp import MlpWeights
    from bcid.models.saving import load_model, save_model
    from bcid.pipeline.config import read_pipeline_file

    models = folder / "model"
    models.mkdir()
    rng = np.random.default_rng(1)
    W1, W2, W3 = (0.1 * rng.standard_normal(size).astype(np.float32) for size in ((6, 8), (8, 4), (4, 3)))
    b1, b2, b3 = (np.zeros(n, np.float32) for n in (8, 4, 3))
    weights = MlpWeights(np.zeros(6), np.ones(6), W1, b1, W2, b2, W3, b3, np.zeros(3), np.ones(3))
    save_model(KMlp(weights, published.k_sindy().car, {}), models)
    (folder / "pipeline.toml").write_bytes((Path(__file__).parents[2] / "pipelines" / "bumper_car.toml").read_bytes())

    def model() -> Any:
        data, arrays = load_model(models).to_saved()
        return {"content": json.dumps(data, sort_keys=True) + str({k: v.tobytes() for k, v in sorted(arrays.items())})}

    return [
        Specimen("model.json", models / "model.json", model, TEXT, True),
        Specimen("arrays.safetensors", models / "arrays.safetensors", model, BYTES, True),
        Specimen("vehicle TOML", folder / "car.toml", partial(read_vehicle, folder / "car.toml"), TEXT, False),
        Specimen(
            "pipeline TOML",
            folder / "pipeline.toml",
            partial(read_pipeline_file, folder / "pipeline.toml"),
            TEXT,
            False,
        ),
    ]


def _kept(folder: Path, recording: Recording) -> list[Specimen]:
    """A workspace's artifact, which is used as it was written, or refused and made anew."""
    recipe = Recipe("ingest", {"take": "1"}, {}, StageCode("c0de", {"numpy": "2"}))
    store = Store(folder / "workspace")
    made = store.get_or_make(recipe, partial(save_recording, recording)).folder

    def again(folder: Path) -> None:
        raise InputRefused(folder, "artifact", "is not as it was written", "it is made anew")

    def read() -> Any:
        return seen(load_recording(store.get_or_make(recipe, again).folder))

    return [
        Specimen(f"artifact's {name}", made / name, read, how, True)
        for name, how in (("manifest.json", TEXT), ("recording.json", TEXT), ("poses.parquet", BYTES))
    ]

"""Counts that need no random files: the conformance suite, flipped bits in artifacts, files that expand."""

from __future__ import annotations

import dataclasses
import json
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.records import MessageIndex

from bcid.files.source_code import StageCode
from bcid.recording.formats.detect import MCAP_MAGIC
from bcid.recording.formats.mcap_chunks import DamagedRecord
from bcid.recording.formats.mcap_records import iterate_records
from bcid.store.artifact import Recipe, is_whole
from faults.killing import prepared, start

GIB = 1 << 30
COSTS = """
import resource, sys, time
from pathlib import Path
from bcid.recording.formats.mcap_chunks import DamagedRecord
from bcid.recording.formats.mcap_records import iterate_records
before, begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
try:
    broken = any(isinstance(entry.record, DamagedRecord) for entry in iterate_records(Path(sys.argv[1])))
except DamagedRecord:
    broken = True
more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
print(int(broken), time.process_time() - begin, more / 1024)
"""


def described(record: Any) -> dict[str, Any]:
    """A record as the conformance suite's descriptions write it: numbers as text, bytes as a list of numbers."""

    def told(value: Any) -> Any:
        if isinstance(value, dict):
            return {str(k): told(v) for k, v in value.items()}
        return [str(b) for b in value] if isinstance(value, bytes) else str(value)

    fields = sorted((f.name, told(getattr(record, f.name))) for f in dataclasses.fields(record))
    return {"type": type(record).__name__, "fields": [list(f) for f in fields]}


def conformance(folder: Path) -> dict[str, int]:
    """How many files of the suite in `folder` there are, and how many read as their descriptions say."""
    paths = sorted(folder.rglob("*.mcap"))
    return {"files": len(paths), "as_described": sum(_as_described(p) for p in paths)}


def _as_described(path: Path) -> bool:
    wanted = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))["records"]
    try:
        read = [r.record for r in iterate_records(path, attachments=True)]
    except DamagedRecord:
        return False
    return [described(r) for r in read if not isinstance(r, MessageIndex)] == wanted


def flips(workspace: Path, n: int) -> dict[str, int]:
    """Of `n` bits flipped one by one in each stage's largest artifact, the manifest among its files: those noticed."""
    rng, found = np.random.default_rng(5), dict[str, int]()
    for stage in sorted(p for p in workspace.iterdir() if list(p.glob("*/manifest.json"))):
        folder = max((m.parent for m in stage.glob("*/manifest.json")), key=lambda f: sum(1 for _ in f.rglob("*")))
        recipe = _recipe_of(json.loads((folder / "manifest.json").read_text()))
        files = [p for p in folder.rglob("*") if p.is_file() and p.stat().st_size]
        if not is_whole(folder, recipe):
            raise RuntimeError(f"{folder} is not whole before anything is flipped")
        found[stage.name] = 0
        for _ in range(n):
            path = files[int(rng.integers(len(files)))]
            whole, bit = path.read_bytes(), int(rng.integers(8 * path.stat().st_size))
            flipped = bytearray(whole)
            flipped[bit // 8] ^= 1 << bit % 8
            path.write_bytes(bytes(flipped))
            found[stage.name] += not is_whole(folder, recipe)
            path.write_bytes(whole)
        if not is_whole(folder, recipe):
            raise RuntimeError(f"{folder} is not whole after all was put back")
    return found


def _recipe_of(manifest: dict[str, Any]) -> Recipe:
    code = StageCode(manifest["code"], manifest["packages"])
    return Recipe(manifest["stage"], manifest["inputs"], manifest["settings"], code, manifest["seed"])


def flipped(n: int) -> dict[str, Any]:
    """`flips` in the workspace of a run of its own."""
    with tempfile.TemporaryDirectory() as home:
        prepared(Path(home))
        run = start(Path(home), "workspace")
        _, text = run.communicate()
        if run.returncode != 0:
            raise RuntimeError(text.decode(errors="replace"))
        return {"of_each": n, "noticed": flips(Path(home) / "workspace", n)}


def record(opcode: int, body: bytes) -> bytes:
    """An MCAP record."""
    return struct.pack("<BQ", opcode, len(body)) + body


def _text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def with_chunk(path: Path, content: bytes, declared: int, compression: str = "zstd", times: int = 1) -> Path:
    """A file with one chunk, or several alike, that declare so many bytes each."""
    fields = struct.pack("<QQQI", 1, 1, declared, 0) + _text(compression) + struct.pack("<Q", len(content)) + content
    ends = record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0))
    path.write_bytes(MCAP_MAGIC + record(1, _text("") + _text("")) + times * record(6, fields) + ends + MCAP_MAGIC)
    return path


def bomb(path: Path, declared: int) -> Path:
    """98 kB that expand to 3 GiB, whether the chunk says so or lies."""
    packer, block = zstandard.ZstdCompressor(level=3).compressobj(), bytes(1 << 20)
    return with_chunk(path, b"".join(packer.compress(block) for _ in range(3 << 10)) + packer.flush(), declared)


def small_bombs(path: Path) -> Path:
    """Chunks that are small each, and 780 MiB of empty messages together."""
    message = record(5, struct.pack("<HIQQ", 1, 0, 1, 1))
    content = message * (13 * (1 << 20) // len(message))
    return with_chunk(path, zstandard.ZstdCompressor(level=3).compress(content), len(content), times=60)


def costs(path: Path) -> dict[str, Any]:
    """Whether a file is refused, in what time (s) and memory (MiB) beyond start-up; in a process of its own."""
    done = subprocess.run([sys.executable, "-c", COSTS, str(path)], capture_output=True, text=True, check=True)
    refused, seconds, mebibytes = map(float, done.stdout.split())
    return {"bytes": path.stat().st_size, "refused": bool(refused), "seconds": seconds, "mib": mebibytes}


def bombs() -> dict[str, dict[str, Any]]:
    """`costs` of every kind."""
    with tempfile.TemporaryDirectory() as home:
        return {
            "one chunk of 3 GiB, which says so": costs(bomb(Path(home) / "a.mcap", 3 * GIB)),
            "one chunk of 3 GiB, which lies": costs(bomb(Path(home) / "b.mcap", 1000)),
            "sixty chunks of 13 MiB": costs(small_bombs(Path(home) / "c.mcap")),
        }

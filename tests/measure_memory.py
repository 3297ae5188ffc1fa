"""The memory that reading large recordings takes.

    python tests/measure_memory.py

Each of ROWS is a recording of a kind (motive, mcap, or mcap-json), of so many gigabytes (of 1e9 bytes), in which a car
drives for so many hours at 240 Hz: the rest of the file is other bodies' markers, or the frames of a camera.  It is
written, and a command reads it in a process of its own, whose largest resident memory counts.  docs/results/memory.json
gets the rows.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from large_recordings import RATE_HZ, VEHICLE, write_large_mcap, write_large_motive

from bcid.bench.fleets import run_and_weigh
from bcid.report.content import describe_machine

ROW_BYTES, MARKER_BYTES = 95, 37  # of a Motive export with the car alone, and of every marker more
MOST_MARKERS = 3000  # of which a row has less than the most columns that are read


RESULT = Path(__file__).parents[1] / "docs" / "results" / "memory.json"
ROWS = (
    ("motive", 2.05, 1.8, "ingest"), ("motive", 0.15, 1.8, "estimate"), ("mcap", 3.95, 1.8, "ingest"),
    ("mcap-json", 1.1, 1.0, "ingest"),
)  # fmt: skip


def weigh(kind: str, gigabytes: float, hours: float, command: str) -> dict[str, Any]:
    """Write a recording, and weigh the command that reads it."""
    count, size = int(3600.0 * hours * RATE_HZ), int(1e9 * gigabytes)
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
        if kind == "motive":
            markers = min(MOST_MARKERS, max(0, round((size / count - ROW_BYTES) / MARKER_BYTES)))
            path = write_large_motive(folder / "take.csv", count, markers)
        else:
            path = write_large_mcap(folder / "take.mcap", count, size, as_json=kind == "mcap-json")
        words = [sys.executable, "-m", "bcid", command, str(path), "--vehicle", str(folder / "vehicle.toml")]
        run = run_and_weigh([*words, "--out", str(folder / "work")])
        return {
            "kind": kind, "command": command, "gigabytes": round(path.stat().st_size / 1e9, 2), "poses": count,
            "hours": hours, "exit": run.status, "peak_mib": round(run.peak_mib), "seconds": round(run.wall_s),
        }  # fmt: skip


def main() -> None:
    """Weigh each of ROWS, and write what they took."""
    rows = []
    for asked in ROWS:
        rows.append(weigh(*asked))
        print(json.dumps(rows[-1]), flush=True)  # noqa: T201
    RESULT.write_text(json.dumps({"machine": describe_machine().as_json(), "rows": rows}, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()

"""`python tests/measure_memory.py KIND GIGABYTES HOURS [COMMAND]`: the memory that reading a large recording takes.

A recording is written of the KIND motive, mcap, or mcap-json, of so many GIGABYTES (of 1e9 bytes), in which a car
drives for so many HOURS at 240 Hz: the rest of the file is other bodies' markers, or the frames of a camera.  Then
`bcid ingest`, or another COMMAND such as estimate, reads it in a process of its own, whose largest resident memory is
printed as a row of JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from large_recordings import RATE_HZ, VEHICLE, write_large_mcap, write_large_motive

from bcid.bench.fleets import run_and_weigh

ROW_BYTES, MARKER_BYTES = 95, 37  # of a Motive export with the car alone, and of every marker more
MOST_MARKERS = 3000  # of which a row has less than the most columns that are read


def main(kind: str, gigabytes: float, hours: float, command: str = "ingest") -> None:
    """Write a recording and print what memory it took to read."""
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
        row = {
            "kind": kind, "command": command, "gigabytes": round(path.stat().st_size / 1e9, 2), "poses": count,
            "hours": hours, "exit": run.status, "peak_mib": round(run.peak_mib), "seconds": round(run.wall_s),
        }  # fmt: skip
    print(json.dumps(row))  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:4]), *sys.argv[4:])

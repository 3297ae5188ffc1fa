"""Whether a Dask cluster makes of a fleet's logs what one machine makes, though one of its workers is killed.

    python tests/measure_cluster.py FOLDER [LOGS] [SECONDS]

simulates so many logs (64) of so many seconds (600) in FOLDER, takes them through everything by `bcid fleet --jobs 2`
and on a cluster of two workers, of which one that is at work is killed with -9 after the first diagnosis, and compares
all files of all artifacts by the hashes in their manifests.  Before, four of them are done by themselves: what a log
costs in many, beside what it costs in few.  It writes docs/results/fleet_cluster.json, and fails unless all logs were
done both ways, a worker was killed, and nothing differs.  Model cards and pages tell the command by which they were
made: these are compared without it.  Of what was made here before only the logs are kept.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from clusters import run_cluster

from bcid.bench.fleets import WeighedRun, process_usage, run_and_weigh
from bcid.documents.fleet import FleetDocument
from bcid.report.content import describe_machine
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.samples import VEHICLE, VEHICLE_FILE, SampleTake, write_sample_take

RESULT = Path(__file__).parents[1] / "docs" / "results" / "fleet_cluster.json"
WORKERS, FEW = 2, 4
TELL_THE_COMMAND = ("model_card.json", ".html")
"""Ends of the names of files that tell by which command they were made."""
WHERE = re.compile(r"--out (local|cluster)|--jobs \d+|--dask [^\s<\"&]+")
"""The words of the two commands that differ."""
QUIET = ("--format", "quiet")
MADE_S = "1796000000"
"""When all is made, as it is told: SOURCE_DATE_EPOCH, seconds since 1970."""


def write_logs(home: Path, count: int, seconds: float) -> list[str]:
    """Write logs of a simulated car with what a real one has beside the paper's, and name them; those there stay."""
    (home / "logs").mkdir(parents=True, exist_ok=True)
    (home / VEHICLE_FILE).write_text(VEHICLE, encoding="utf-8")
    names = [f"log_{i:04d}_{seconds:g}s" for i in range(count)]
    for i, name in enumerate(names):
        if not (home / "logs" / f"{name}.mcap").exists():
            write_sample_take(home / "logs", SampleTake(name, "mcap", seconds), Plant(**REAL_EXTRAS), Sensor(), 1 + i)
    return [f"logs/{name}.mcap" for name in names]


def fleet_command(logs: list[str], out: str, *where: str) -> list[str]:
    """The command that takes logs through everything."""
    return [sys.executable, "-m", "bcid", "fleet", *logs, "--vehicle", VEHICLE_FILE, "--out", out, *where, *QUIET]


def run_here(logs: list[str], out: str) -> WeighedRun:
    """Take logs through everything on this machine."""
    return run_and_weigh(fleet_command(logs, out, "--jobs", str(WORKERS)))


def weigh_few_and_many(logs: list[str]) -> dict[str, Any]:
    """The run over all logs on this machine, and what a log costs in it beside what it costs in one over FEW.

    A run before them, over as many logs as there are workers, compiles and is not counted.
    """
    run_here(logs[:WORKERS], "compiled")
    few, many = run_here(logs[:FEW], "few"), run_here(logs, "local")
    return {
        "exit": many.status, "wall_s": round(many.wall_s, 1),
        "few": {"logs": FEW, **describe_cost(few, FEW)}, "many": {"logs": len(logs), **describe_cost(many, len(logs))},
        "growth": round(many.cpu_s / len(logs) / (few.cpu_s / FEW), 3),
        "memory_growth": round(many.peak_mib / few.peak_mib - 1.0, 3),
    }  # fmt: skip


def describe_cost(run: WeighedRun, count: int) -> dict[str, float]:
    """CPU time (s) a log, and the largest memory (MiB) of one process."""
    return {"cpu_s_per_log": round(run.cpu_s / count, 2), "peak_mib": round(run.peak_mib, 1)}


def file_hashes(workspace: Path) -> dict[str, str]:
    """The hash of each file of each artifact in a workspace, by stage, key and name."""
    return {
        f"{path.parent.relative_to(workspace).as_posix()}/{name}": sha256
        for path in workspace.glob("*/*/manifest.json")
        for name, sha256 in json.loads(path.read_text(encoding="utf-8"))["files"].items()
    }


def differs(home: Path, name: str) -> bool:
    """Whether a file of an artifact differs between both runs, but for the words of the commands that do."""
    here, there = home / "local" / name, home / "cluster" / name
    if not (here.exists() and there.exists()):
        return True
    if not name.endswith(TELL_THE_COMMAND):
        return here.read_bytes() != there.read_bytes()
    one, other = (WHERE.sub("", path.read_text(encoding="utf-8")) for path in (here, there))
    return one != other


def run_on_cluster(home: Path, logs: list[str]) -> dict[str, float]:
    """The fleet on a cluster, one of whose workers is killed after the first diagnosis; what the run cost."""
    from distributed import Client

    begin, killed = time.monotonic(), False
    with run_cluster(home, WORKERS, "--nthreads", "1") as cluster:
        run = subprocess.Popen(fleet_command(logs, "cluster", "--dask", cluster.address))
        with Client(cluster.address, set_as_default=False) as client:  # type: ignore[no-untyped-call]
            while run.poll() is None:
                at_work = [worker for worker, calls in client.processing().items() if calls]
                if not killed and at_work and any((home / "cluster").glob("diagnose/*/manifest.json")):
                    os.kill(client.run(os.getpid, workers=at_work[:1])[at_work[0]], signal.SIGKILL)
                    killed = True
                time.sleep(1.0)
            usage = list(client.run(process_usage).values())
    return {
        "exit": float(run.returncode), "killed": float(killed), "wall_s": round(time.monotonic() - begin, 1),
        "peak_mib": round(max(mib for _, mib in usage), 1),
    }  # fmt: skip


def main() -> None:
    """Run the fleet both ways, and write how far the two are the same."""
    home, count = Path(sys.argv[1]).resolve(), int(sys.argv[2]) if len(sys.argv) > 2 else 64
    seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 600.0
    os.environ["SOURCE_DATE_EPOCH"] = MADE_S  # of all processes, as workers of a cluster make pages, too
    logs = write_logs(home, count, seconds)
    os.chdir(home)
    for name in ("compiled", "few", "local", "cluster"):
        shutil.rmtree(home / name, ignore_errors=True)
    local = weigh_few_and_many(logs)
    on_cluster = run_on_cluster(home, logs)
    ours, theirs = file_hashes(home / "local"), file_hashes(home / "cluster")
    unequal = sorted(name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name))
    differing = [name for name in unequal if differs(home, name)]
    states = [log.state for log in FleetDocument.read(home / "cluster" / "fleet.json").logs]
    found = {
        "logs": count, "seconds": seconds, "workers": WORKERS, "machine": describe_machine().as_json(),
        "local": local, "cluster": on_cluster,
        "done": states.count("done"), "files": len(ours), "differ_by_the_command": len(unequal) - len(differing),
        "differ": differing,
    }  # fmt: skip
    RESULT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1))  # noqa: T201
    ended = (
        local["exit"] == 0
        and on_cluster["exit"] == 0.0
        and on_cluster["killed"] == 1.0
        and states.count("done") == count
    )
    if not ended or not ours or differing:
        raise SystemExit("the two runs are not the same, or not what they should be")


if __name__ == "__main__":
    main()

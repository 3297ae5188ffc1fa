"""What a fleet of logs costs as it grows, and how much faster more processes are: runs of `bcid fleet`, weighed whole.

Every run is a process of its own, so that its time and memory are those of all processes that it has started.  On a
Dask cluster they are the workers', too, which outlive a run: they are asked before and after it, their largest memory
is cleared before, and small fleets come before large ones, as a process keeps some of the memory that it once had.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from bcid.aliases import Progress
from bcid.bench.limits import FLEETS
from bcid.bench.run import SCHEMA
from bcid.documents.fleet import FleetDocument
from bcid.errors import UsageError
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.samples import VEHICLE, VEHICLE_FILE, SampleTake, write_sample_take

ARCHIVE_HOURS = 10_000.0
"""Length of the archive for which cost is reckoned, not measured."""


class FleetCost(NamedTuple):
    """What one run over a fleet cost."""

    logs: int
    workers: int
    failed: int  # logs that did not come through wholly
    wall_s: float
    cpu_s: float  # of all processes
    peak_mib: float  # largest resident memory of any one process during this run
    disk_mib: float  # of the workspace


class WeighedRun(NamedTuple):
    """What a command and all that it has started took."""

    status: int  # with which it ended
    wall_s: float
    cpu_s: float
    peak_mib: float  # largest resident memory of any one process


def measure_fleets(
    counts: Sequence[int], seconds: float, workers: int, dask: str | None, progress: Progress
) -> list[FleetCost]:
    """Costs of fleets of so many logs of `seconds` each, in so many processes, the smallest in one process as well.

    With `dask`, the address of a scheduler, the work goes to its cluster, whose number of workers counts.  The smallest
    fleet comes first.
    """
    # the first run is not counted: it compiles, and loads in workers that outlive it, what later ones find there; so
    # each worker is given two logs, the fewest of which one can be evaluated on the other
    orders = [
        (2 * max(len(_cluster_usage(dask)), 1), workers),
        *([(min(counts), 1)] if workers > 1 and dask is None else []),
        *((n, workers) for n in sorted(counts)),
    ]
    with TemporaryDirectory() as name:
        home = Path(name)
        logs = [_write_log(home, i, seconds) for i in range(max(n for n, _ in orders))]
        found = list[FleetCost]()
        for k, (count, processes) in enumerate(orders):
            progress(k / len(orders), f"{count} logs in {processes} processes" if dask is None else f"{count} logs")
            found.append(_run_fleet(home, logs[:count], processes, dask, home / f"work_{k}"))
        return found[1:]


def _write_log(home: Path, number: int, seconds: float) -> Path:
    """A simulated log with what a real car has beside the paper's."""
    take = SampleTake(f"log_{number:04d}", "mcap", seconds)
    (home / VEHICLE_FILE).write_text(VEHICLE, encoding="utf-8")
    return write_sample_take(home, take, Plant(**REAL_EXTRAS), Sensor(), 1 + number)


def _run_fleet(home: Path, logs: Sequence[Path], workers: int, dask: str | None, out: Path) -> FleetCost:
    """Run `bcid fleet` on logs, and weigh it."""
    where = ["--jobs", str(workers)] if dask is None else ["--dask", dask]
    words = ["fleet", *map(str, logs), "--vehicle", str(home / VEHICLE_FILE), "--out", str(out), *where]
    before = _cluster_usage(dask, clear_peak=True)
    run = run_and_weigh([sys.executable, "-m", "bcid", *words, "--format", "quiet"])
    after = _cluster_usage(dask)
    # a worker that was started anew meanwhile began with nothing
    on_cluster = sum(cpu - before.get(worker, (0.0, 0.0))[0] for worker, (cpu, _) in after.items())
    peak = max([run.peak_mib, *(mib for _, mib in after.values())])
    rows = FleetDocument.read(out / "fleet.json").logs
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file()) / 2**20
    return FleetCost(
        len(logs), len(after) or workers, sum(row.state != "done" for row in rows), run.wall_s, run.cpu_s + on_cluster,
        peak, size,
    )  # fmt: skip


def run_and_weigh(command: list[str]) -> WeighedRun:
    """Run a command, and what it and all that it has started took; its output is dropped, its errors are shown.

    Raises:
        UsageError: this is Windows, which does not tell.
    """
    if sys.platform == "win32":
        raise UsageError("fleets are weighed as POSIX systems do\n  next: run it on Linux")
    if sys.platform == "linux":
        clear_peak_memory()  # a process begins with the largest memory of the one that starts it
    begin = time.perf_counter()
    dropped = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    pid = os.posix_spawnp(command[0], command, os.environ, file_actions=dropped)
    _, status, usage = os.wait4(pid, 0)
    wall_s, cpu_s = time.perf_counter() - begin, usage.ru_utime + usage.ru_stime
    return WeighedRun(os.waitstatus_to_exitcode(status), wall_s, cpu_s, usage.ru_maxrss / 1024.0)


def _cluster_usage(dask: str | None, clear_peak: bool = False) -> dict[str, tuple[float, float]]:
    """CPU time (s) and largest resident memory (MiB) of each worker of a Dask cluster; empty without one.

    With `clear_peak` what each had largest so far is forgotten, and what it has now counts from here on.
    """
    if dask is None:
        return {}
    from distributed import Client

    with Client(dask, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        if clear_peak:
            client.run(clear_peak_memory)
        return dict(client.run(process_usage))


def clear_peak_memory() -> None:
    """Let the largest resident memory of this process be what it has now, as Linux allows (proc_pid_clear_refs(5))."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def process_usage() -> tuple[float, float]:
    """CPU time (s) of this process, and its largest resident memory (MiB) since `clear_peak_memory`, as Linux tells."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak_kib = next(float(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    return time.process_time(), peak_kib / 1024.0


def summarise_fleets(costs: Sequence[FleetCost], seconds: float, machine: dict[str, Any]) -> dict[str, Any]:
    """The fleet benchmark's JSON: cost per log, growth from the smallest fleet to the largest, speed-up, goals missed.

    `archive` is reckoned from the largest fleet: hours of time and GiB of disk for `ARCHIVE_HOURS` of logs.
    """
    most = max(cost.workers for cost in costs)
    same = sorted((cost for cost in costs if cost.workers == most), key=lambda cost: cost.logs)
    small, large = same[0], same[-1]
    growth = (large.cpu_s / large.logs) / (small.cpu_s / small.logs)
    memory = large.peak_mib / small.peak_mib - 1.0
    single = next((c for c in costs if c.workers == 1 and c.logs == small.logs), None)
    log_count = 3600.0 * ARCHIVE_HOURS / seconds
    missed = [f"{c.failed} of {c.logs} logs failed" for c in costs if c.failed]
    if growth > FLEETS.most_growth:
        missed.append(f"a log costs {growth:.2f} times as much in {large.logs} as in {small.logs}")
    if memory > FLEETS.most_memory_growth:
        missed.append(f"memory grows by {100.0 * memory:.0f} %")
    return {
        "schema": SCHEMA, "what": "fleet", "seconds": seconds, "machine": machine,
        "rows": [{**c._asdict(), "cpu_s_per_log": c.cpu_s / c.logs} for c in costs],
        "growth": growth, "memory_growth": memory,
        "speed_up": single.wall_s / small.wall_s if single and most > 1 else None, "workers": most,
        "archive": {
            "hours": ARCHIVE_HOURS, "measured": False, "cpu_hours": log_count * large.cpu_s / large.logs / 3600.0,
            "disk_gib": log_count * large.disk_mib / large.logs / 1024.0,
        },
        "missed": missed,
    }  # fmt: skip

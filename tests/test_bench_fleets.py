"""What fleets cost: the figures of runs, the goals that they miss, and one small run."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bcid.bench import fleets
from bcid.bench.fleets import (
    FleetCost,
    clear_peak_memory,
    measure_fleets,
    process_usage,
    run_and_weigh,
    summarise_fleets,
)
from bcid.cli.app import app
from bcid.execution.cluster import Cluster

SMALL = FleetCost(logs=4, workers=2, failed=0, wall_s=100.0, cpu_s=200.0, peak_mib=500.0, disk_mib=40.0)
LARGE = FleetCost(logs=64, workers=2, failed=0, wall_s=1650.0, cpu_s=3300.0, peak_mib=520.0, disk_mib=640.0)


def test_growth_and_speed_up_are_those_of_the_runs() -> None:
    single = SMALL._replace(workers=1, wall_s=190.0)
    found = summarise_fleets([single, SMALL, LARGE], 600.0, {})
    assert found["growth"] == pytest.approx(51.5625 / 50.0)
    assert found["memory_growth"] == pytest.approx(0.04)
    assert found["speed_up"] == pytest.approx(1.9)
    # 60,000 logs of ten minutes
    assert found["archive"]["cpu_hours"] == pytest.approx(6e4 * 51.5625 / 3600.0)
    assert found["archive"]["disk_gib"] == pytest.approx(6e4 * 10.0 / 1024.0)
    assert not found["missed"]


@pytest.mark.parametrize(
    ("large", "missed"),
    [
        (LARGE._replace(cpu_s=64 * 50.0 * 1.11), "times as much"),
        (LARGE._replace(peak_mib=560.0), "memory grows by 12 %"),
        (LARGE._replace(failed=3), "3 of 64 logs failed"),
    ],
)
def test_a_goal_that_is_missed_is_told(large: FleetCost, missed: str) -> None:
    (told,) = summarise_fleets([SMALL, large], 600.0, {})["missed"]
    assert missed in told


def use_memory(mib: int) -> int:
    """Have so much memory for a moment."""
    return len(np.ones(mib * 2**17))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells and clears it")
def test_memory_of_earlier_runs_is_not_counted() -> None:
    clear_peak_memory()  # of tests before this one
    before = process_usage()[1]
    use_memory(200)
    assert process_usage()[1] > before + 100.0
    clear_peak_memory()
    assert process_usage()[1] < before + 100.0


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells and clears it")
def test_memory_that_the_weighing_process_once_had_is_not_the_command_s() -> None:
    clear_peak_memory()
    now = process_usage()[1]
    use_memory(600)
    assert process_usage()[1] > now + 500.0
    assert run_and_weigh([sys.executable, "-c", "pass"]).peak_mib < now + 100.0


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells and clears it")
def test_memory_of_earlier_runs_on_a_cluster_is_not_counted(scheduler: str) -> None:
    with Cluster(scheduler) as cluster:
        cluster.submit(0, partial(use_memory, 400))
        assert cluster.next_results() == [(0, 400 * 2**17)]
    assert max(peak for _, peak in fleets._cluster_usage(scheduler).values()) > 400.0
    cleared = fleets._cluster_usage(scheduler, clear_peak=True)
    assert len(cleared) == 2
    assert max(peak for _, peak in cleared.values()) < 400.0


@pytest.mark.parametrize(("on_cluster", "runs"), [(0, [(2, 3), (4, 1), (4, 3), (9, 3)]), (3, [(6, 3), (4, 3), (9, 3)])])
def test_what_is_measured_is_warm_and_small_fleets_come_first(
    on_cluster: int, runs: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run before those that count gives each process that outlives it two logs."""
    begun = list[tuple[int, int]]()

    def run_fleet(home: Path, logs: list[Path], workers: int, dask: str | None, out: Path) -> FleetCost:
        begun.append((len(logs), workers))
        return SMALL._replace(logs=len(logs), workers=workers)

    monkeypatch.setattr(fleets, "_cluster_usage", lambda dask: {f"{n}": (0.0, 0.0) for n in range(on_cluster)})
    monkeypatch.setattr(fleets, "_run_fleet", run_fleet)
    monkeypatch.setattr(fleets, "_write_log", lambda home, number, seconds: home / f"{number}")
    found = measure_fleets([9, 4], 600.0, 3, "tcp://desk:8786" if on_cluster else None, lambda share, text: None)
    assert begun == runs
    assert [(cost.logs, cost.workers) for cost in found] == runs[1:]


@pytest.mark.slow
def test_a_small_fleet_is_weighed(tmp_path: Path) -> None:
    out = tmp_path / "fleet.json"
    words = ["bench", "fleet", "--logs", "2", "--seconds", "40", "--workers", "1", "--out", str(out)]
    ran = CliRunner().invoke(app, words)
    assert ran.exit_code == 0, ran.output
    (row,) = json.loads(out.read_text(encoding="utf-8"))["rows"]
    assert (row["logs"], row["workers"], row["failed"]) == (2, 1, 0)
    # a run of the libraries alone takes two seconds, and 100 MiB
    assert row["cpu_s"] > 2.0
    assert row["peak_mib"] > 100.0
    assert row["disk_mib"] > 0.1
    assert "not measured but reckoned" in ran.output

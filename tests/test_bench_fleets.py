"""What fleets cost: the figures of runs, the goals that they miss, and one small run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bcid.bench.fleets import FleetCost, summarise_fleets
from bcid.cli.app import app

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

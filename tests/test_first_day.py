"""A stranger's first day: takes of a car that is no sample, commands in another logger's columns, a tape measure.

Three commands lead to a report and a fourth one to a diagnosis, as the README says.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
DELAY_S = 0.06
"""What the car has and no model knows: its steering acts late."""
LOGGED = """
[commands]
time_s = { from = "Time (ms)", gain = 0.001 }
steering_rad = { from = "steer [deg]", gain = 0.017453292519943295 }
throttle_mps = { from = "gas", gain = 2.0 }
"""


def bcid(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A command as it is typed, which must end well."""
    done = subprocess.run(
        [sys.executable, "-m", "bcid", *words], text=True, capture_output=True, cwd=cwd, timeout=900, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done


def log_otherwise(commands: Path) -> None:
    """Write a commands file as a logger of its own would: milliseconds, degrees, a share of the largest speed."""
    _, *rows = commands.read_text(encoding="utf-8").split()
    lines = ["Time (ms),steer [deg],gas,battery (V)"]
    for row in rows:
        time_s, steering, throttle = map(float, row.split(",")[:3])
        lines.append(f"{1e3 * time_s:.1f},{math.degrees(steering):.4f},{0.5 * throttle:.5f},7.9")
    commands.write_text("\n".join(lines) + "\n", encoding="utf-8")


def fill_in(file: Path, **lines: str) -> None:
    """Edit a file of `bcid init` as a person does: each key's line, commented out or not, becomes another."""
    kept = file.read_text(encoding="utf-8").splitlines()
    for key, line in lines.items():
        (place,) = [i for i, old in enumerate(kept) if old.removeprefix("# ").startswith(f"{key} = ")]
        kept[place] = line
    file.write_text("\n".join(kept) + "\n", encoding="utf-8")


@pytest.mark.slow
def test_three_commands_lead_to_a_report_and_a_fourth_to_a_diagnosis(tmp_path: Path) -> None:
    lab = tmp_path / "my-lab"
    bcid("init", "my-lab", cwd=tmp_path)
    for take, seed in (("monday", "41"), ("tuesday", "42")):
        words = ("--ideal", "--duration", "90", "--seed", seed, "--set", f"steering_delay={DELAY_S}", "--out", ".")
        bcid("simulate", take, *words, cwd=lab)
        log_otherwise(lab / f"{take}.commands.csv")
    fill_in(
        lab / "vehicle.toml", name='name = "go-kart"', cog_to_front_m="cog_to_front_m = 0.54",
        cog_to_rear_m="cog_to_rear_m = 0.33", mass_kg="mass_kg = 320.0", rear_track_m="rear_track_m = 0.6",
        max_angle_rad="max_angle_rad = 2.01",
    )  # fmt: skip
    with (lab / "vehicle.toml").open("a", encoding="utf-8") as file:
        file.write(LOGGED)
    fill_in(
        lab / "pipeline.toml", training='training = ["monday.csv"]', validation='validation = "tuesday.csv"',
        models='models = ["newton-euler", "k-sindy"]', losses="losses = []",
    )  # fmt: skip
    checked = json.loads(bcid("ingest", "--check", "--format", "json", cwd=lab).stdout)
    assert [take["go"] for take in checked["recordings"]] == [True, True]
    assert "newton-euler" in bcid("run", cwd=lab).stdout
    report = json.loads((lab / "workspace" / "report" / "report.json").read_text(encoding="utf-8"))
    assert {model["model"] for model in report["models"]} == {"newton-euler", "k-sindy"}
    assert (lab / "workspace" / "report" / "index.html").is_file()
    bcid("diagnose", cwd=lab)
    found = json.loads((lab / "workspace" / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    named = {finding["effect"]: finding["parameters"] for finding in found["findings"]}
    assert set(named) == {"steering_delay"}
    (delay,) = named["steering_delay"].values()
    assert delay["value"] == pytest.approx(DELAY_S, abs=max(0.01, 4.0 * delay["se"]))
    assert (lab / "workspace" / "diagnosis" / "diagnosis.html").is_file()

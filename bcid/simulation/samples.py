"""`sample_logs/`: four training takes, one validation take, one to diagnose, and the vehicle file, from one seed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.drive import drive
from bcid.simulation.writing import write_mcap, write_motive, write_truth


class Take(NamedTuple):
    """One committed take."""

    name: str
    format: str
    duration_s: float
    conceals: tuple[tuple[str, float], ...] = ()  # constants of the plant that differ from the other takes' car


TAKES = (
    Take("training_1", "motive", 300.0),
    Take("training_2", "motive", 300.0),
    Take("training_3", "mcap", 300.0),
    Take("training_4", "mcap", 300.0),
    Take("validation", "motive", 110.0),
    Take(
        "another_day", "mcap", 300.0,
        (("rough_patch", 30.0), ("rough_patch_x", 1.8), ("rough_patch_y", -0.9), ("rough_patch_radius", 1.2)),
    ),
)  # fmt: skip

VEHICLE = """\
# The simulated bumper car of these logs. Known of it: what a lab would measure or read from data sheets.
name = "bumper-car"

[body]
mass_kg = 319.6
cog_to_front_m = 0.54
cog_to_rear_m = 0.33
drive = "front"
rear_track_m = 0.60

[steering]
max_angle_rad = 2.012
max_rate_radps = 1.418
time_constant_s = 0.155

[motor]
reference_speed_mps = 2.033

[mocap]
rigid_body = "bumper_car"
up_axis = "Y"

[topics]
pose = "/mocap/bumper_car/pose"
command = "/bumper_car/command"
"""

ABOUT = """\
These logs are simulated: `bcid simulate --sample-logs sample_logs --seed 1` makes them.
The car is the paper's, with two rear wheels, rear drag, soft tyres and a rough floor that no fitted model knows.
`another_day` is the same car on a floor that has changed somewhere: `bcid diagnose` says where and how.
`truth/` holds the true motion at 10 Hz; only the check of the estimator reads it.
"""


def write_take(folder: Path, take: Take, plant: Plant, sensor: Sensor, seed: int) -> Path:
    """Simulate one take and write it with its truth; returns the recording's path."""
    run = drive(plant, sensor, take.duration_s, seed)
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    write_truth(folder / "truth" / f"{take.name}.parquet", run)
    path = folder / f"{take.name}.{'mcap' if take.format == 'mcap' else 'csv'}"
    (write_mcap if take.format == "mcap" else write_motive)(path, run, sensor.rate_hz, seed)
    return path


def write_samples(folder: Path, seed: int, progress: Callable[[str], None] = lambda text: None) -> list[Path]:
    """Make all of `sample_logs/` in `folder`; returns the recordings' paths."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bumper_car.toml").write_text(VEHICLE)
    (folder / "README.md").write_text(ABOUT)
    paths = []
    for i, take in enumerate(TAKES):
        progress(take.name)
        paths.append(write_take(folder, take, Plant(**REAL_EXTRAS, **dict(take.conceals)), Sensor(), 1000 * seed + i))
    return paths

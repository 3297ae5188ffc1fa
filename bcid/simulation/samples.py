"""`sample_logs/`: four training takes, one validation take, one to diagnose, and the vehicle file, from one seed."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from bcid.files.parquet import write_columns
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.simulation.writing import write_mcap_take, write_motive_take


class SampleTake(NamedTuple):
    """One simulated take to be written, such as those of the committed sample logs."""

    name: str
    format: str
    duration_s: float
    conceals: tuple[tuple[str, float], ...] = ()  # constants of the plant that differ from the other takes' car

    def files(self) -> tuple[str, ...]:
        """Names of the files of the take's recording, its log first."""
        return (f"{self.name}.mcap",) if self.format == "mcap" else (f"{self.name}.csv", f"{self.name}.commands.csv")

    def truth_file(self) -> str:
        """Name of the file of the take's true motion, in the folder `truth`."""
        return f"{self.name}.parquet"


TAKES = (
    SampleTake("training_1", "motive", 300.0),
    SampleTake("training_2", "motive", 300.0),
    SampleTake("training_3", "mcap", 300.0),
    SampleTake("training_4", "mcap", 300.0),
    SampleTake("validation", "motive", 110.0),
    SampleTake(
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


VEHICLE_FILE = "bumper_car.toml"
# beside the takes, in the folder of the sample logs
SAMPLE_TEXTS = {VEHICLE_FILE: VEHICLE, "README.md": ABOUT}
TRUTH_UNITS = {
    "time": "s", "x": "m", "y": "m", "yaw": "rad", "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s", "delta": "rad",
}  # fmt: skip


def write_sample_take(folder: Path, take: SampleTake, plant: Plant, sensor: Sensor, seed: int) -> Path:
    """Simulate one take; write its log, and into `folder`/truth its true motion (10 Hz); return the log's path."""
    run = simulate_drive(plant, sensor, take.duration_s, seed)
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    write_columns(folder / "truth" / take.truth_file(), run.truth, TRUTH_UNITS)
    path = folder / take.files()[0]
    (write_mcap_take if take.format == "mcap" else write_motive_take)(path, run, sensor.rate_hz, seed)
    return path


def sample_files(takes: Iterable[SampleTake]) -> list[str]:
    """Names of all files of simulated takes: their logs, and their true motion in the folder `truth`."""
    takes = list(takes)
    return [file for take in takes for file in take.files()] + [f"truth/{take.truth_file()}" for take in takes]


def write_sample_logs(folder: Path, seed: int, progress: Callable[[str], None] = lambda text: None) -> list[Path]:
    """Simulate all takes of `sample_logs/` and write them, the vehicle file and a README into `folder`.

    Returns the paths of the takes' logs.  `progress` is called with the name of each take before it is simulated.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in SAMPLE_TEXTS.items():
        (folder / name).write_text(text)
    paths = []
    for i, take in enumerate(TAKES):
        progress(take.name)
        plant = Plant(**REAL_EXTRAS, **dict(take.conceals))
        paths.append(write_sample_take(folder, take, plant, Sensor(), 1000 * seed + i))
    return paths

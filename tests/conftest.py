"""What several tests share: small simulated takes, and the real recordings where they are there."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from clusters import run_cluster
from hypothesis import settings

from bcid.estimate.consistency import Truth
from bcid.estimate.run import estimate_motion
from bcid.estimate.saving import read_truth
from bcid.estimate.tuning import Noise, Tuning
from bcid.estimate.types import Estimate
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.samples import VEHICLE, SampleTake, write_sample_take
from bcid.vehicle import Vehicle, read_vehicle

# a shell without job control has what it starts in the background ignore Ctrl-C, as do the processes that this starts
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("kernels", deadline=None)  # the first call compiles
settings.load_profile("kernels")

# they measure memory, and end groups of processes, as POSIX does
collect_ignore = ["test_battery.py", "test_faults.py"] if os.name == "nt" else []

ROOT = Path(__file__).parent.parent
SAMPLES = ROOT / "sample_logs"


@pytest.fixture(scope="session")
def recordings_folder() -> Path:
    """The real recordings, which are never committed."""
    folder = Path(os.environ.get("BCID_RECORDINGS", ROOT.parent / "shared" / "recordings"))
    if not folder.is_dir():
        pytest.skip("the real recordings are not here (set BCID_RECORDINGS to their folder)")
    return folder


@pytest.fixture(scope="session")
def vehicle_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("vehicle") / "bumper_car.toml"
    path.write_text(VEHICLE)
    return path


@pytest.fixture(scope="session")
def vehicle(vehicle_file: Path) -> Vehicle:
    return read_vehicle(vehicle_file)


@pytest.fixture(scope="session")
def takes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Short simulated takes of the real-looking car: `motive` and `mcap` are the same drive."""
    folder = tmp_path_factory.mktemp("takes")
    plant, sensor = Plant(**REAL_EXTRAS), Sensor()
    return {
        "motive": write_sample_take(folder, SampleTake("drive", "motive", 60.0), plant, sensor, 11),
        "mcap": write_sample_take(folder, SampleTake("drive_m", "mcap", 60.0), plant, sensor, 11),
        "other": write_sample_take(folder, SampleTake("other", "motive", 60.0), plant, sensor, 12),
    }


@pytest.fixture(scope="session")
def recording(takes: dict[str, Path], vehicle: Vehicle) -> Recording:
    return read_recording(takes["motive"], vehicle)


@pytest.fixture(scope="session")
def tuning() -> Tuning:
    """Noise that suits the simulated takes, as `tune` finds it there."""
    return Tuning(
        noise=Noise(q_v_f=0.15, q_beta_f=0.2, q_beta_r=0.025, q_delta=0.01, r_position=5e-4, r_yaw=1e-3),
        T_s=0.155,
        d=1.418,
    )


@pytest.fixture(scope="session")
def truth(takes: dict[str, Path], vehicle: Vehicle) -> Truth:
    return read_truth(takes["motive"].parent / "truth" / "drive.parquet", vehicle)


@pytest.fixture(scope="session")
def estimates(takes: dict[str, Path], vehicle: Vehicle, tuning: Tuning) -> list[Estimate]:
    """The two takes' estimates: enough to fit small models on."""
    return [estimate_motion(read_recording(takes[n], vehicle), vehicle, tuning) for n in ("motive", "other")]


@pytest.fixture(scope="session")
def cluster_of_two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the scheduler of two workers, some of which tests kill."""
    with run_cluster(tmp_path_factory.mktemp("dask"), 2, "--nthreads", "1") as cluster:
        yield cluster.address


@pytest.fixture
def scheduler(cluster_of_two: str) -> str:
    """The address of a Dask scheduler with two workers; those that an earlier test killed have been started anew."""
    from distributed import Client

    with Client(cluster_of_two, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        client.wait_for_workers(2, timeout=60.0)  # type: ignore[no-untyped-call]
    return cluster_of_two

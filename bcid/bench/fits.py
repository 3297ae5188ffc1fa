"""Fits, filters and training against deap, filterpy and torch's DataLoader."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from bcid.bench.timing import Row, compared
from bcid.estimate import kernel, reference
from bcid.estimate.events import timeline
from bcid.estimate.noise import Noise
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.models.interface import FitTask
from bcid.models.newton_euler import NewtonEuler
from bcid.models.settings import NewtonEulerSettings, TrainingSettings
from bcid.models.training import epoch, network, optimiser
from bcid.recording.types import Recording, Source, Stream
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.drive import drive
from bcid.vehicle import Vehicle

Floats = npt.NDArray[np.float64]

HOUR_S = 3600.0
FILTERED_S = 20.0  # of poses that both filters go through
VELOCITY_NOISE = (0.008, 0.004, 0.010)  # of a smoother's twist on such logs
SAMPLES = 36_000

CAR: dict[str, Any] = {
    "name": "bumper-car",
    "body": {"mass_kg": 319.6, "cog_to_front_m": 0.54, "cog_to_rear_m": 0.33, "drive": "front", "rear_track_m": 0.6},
    "steering": {"max_angle_rad": 2.012, "max_rate_radps": 1.418, "time_constant_s": 0.155},
    "motor": {"reference_speed_mps": 2.033},
}


def hour(seed: int = 1, seconds: float = HOUR_S) -> Estimate:
    """A simulated hour at 10 Hz as a smoother gives it: the true motion with its noise."""
    run = drive(Plant(**REAL_EXTRAS), Sensor(), seconds, seed)
    twist, delta = run.truth[:, 4:7].copy(), run.truth[:, 7]
    twist += np.random.default_rng(seed).standard_normal(twist.shape) * VELOCITY_NOISE
    n = len(twist)
    v_fy, v_ry = twist[:, 1] + 0.54 * twist[:, 2], twist[:, 1] - 0.33 * twist[:, 2]
    slip = np.angle(np.exp(1j * (np.arctan2(v_fy, twist[:, 0]) - delta)))
    rear = np.arctan(v_ry / np.where(np.abs(twist[:, 0]) < 0.1, 0.1, twist[:, 0]))
    kinematic = np.column_stack([np.hypot(twist[:, 0], v_fy), slip, rear, delta])
    command = run.command[np.minimum(2 * np.arange(n), len(run.command) - 1)]
    return Estimate(
        "hour", 0.1, run.truth[:, 0], np.ones(n, dtype=np.int64), run.truth[:, 1:4], twist, kinematic, command,
        np.zeros((n, 3)), np.zeros((n, 4)), {"T_s": 0.155, "d": 1.418},
    )  # fmt: skip


def white_box(repeats: int) -> Iterator[Row]:
    """Least squares from several starts against a hundred generations on the same objective, once each.

    `difference` is by how much the least squares' NMSE is above the genetic algorithm's: not at all where negative.
    """
    take, vehicle = hour(), Vehicle.model_validate(CAR)
    settings = NewtonEulerSettings().model_dump()
    small = FitTask([hour(2, 60.0)], vehicle, settings | {"generations": 1, "starts": 1, "population": 10}, 1)
    NewtonEuler.fit(small)  # compiles
    found: dict[str, tuple[float, float]] = {}
    for way in ("levenberg-marquardt", "genetic"):
        begin = time.perf_counter()
        model = NewtonEuler.fit(FitTask([take], vehicle, settings | {"optimiser": way}, 1))
        found[way] = 1e3 * (time.perf_counter() - begin), model.facts["nmse"]
    (ours, mine), (peer, theirs) = found["levenberg-marquardt"], found["genetic"]
    yield Row("fit newton-euler, an hour", "deap, 100 generations", ours, peer, 30.0, mine / theirs - 1.0)


def filters(repeats: int) -> Iterator[Row]:
    """The extended Kalman filter and its smoother."""
    vehicle = Vehicle.model_validate(CAR)
    run = drive(Plant(**REAL_EXTRAS), Sensor(dropouts_per_minute=0.0), FILTERED_S, 1)
    recording = Recording(
        "bench", (Source("bench", "", "mcap"),), Stream(run.frame / 60.0, run.pose),
        Stream(run.command_time, run.command), 60.0, 0.05,
    )  # fmt: skip
    tuning = Tuning(Noise(0.15, 0.2, 0.025, 0.01, 5e-4, 1e-3), 0.155, 1.418)
    events = timeline(recording, vehicle, 0.1, 0.3, tuning.T_s, tuning.d).events
    chassis, Q, R = tuning.chassis(vehicle), tuning.noise.Q(), tuning.noise.R()
    ours, theirs = (engine.run_filter(events, chassis, Q, R) for engine in (kernel, reference))
    off = float(np.abs(ours.x - theirs.x).max())
    yield from compared(
        "EKF", lambda: kernel.run_filter(events, chassis, Q, R),
        {"filterpy": (lambda: reference.run_filter(events, chassis, Q, R), 50.0, off)}, repeats,
    )  # fmt: skip
    smooth = [engine.run_smoother(ours, events.restart)[0] for engine in (kernel, reference)]
    apart = float(np.abs(smooth[0] - smooth[1]).max())
    yield from compared(
        "RTS smoother", lambda: kernel.run_smoother(ours, events.restart),
        {"filterpy": (lambda: reference.run_smoother(ours, events.restart), 20.0, apart)}, repeats,
    )  # fmt: skip


def training(repeats: int) -> Iterator[Row]:
    """An epoch of a perceptron over an hour's samples."""
    import torch
    from torch.utils.data import DataLoader, TensorDataset

    torch.set_num_threads(1)
    settings = TrainingSettings()
    rng = np.random.default_rng(0)
    x, y = (torch.tensor(rng.standard_normal((SAMPLES, n)), dtype=torch.float32) for n in (6, 3))
    ours, theirs = (network(6, settings, 3) for _ in range(2))
    fused = optimiser(ours, settings)
    batches = DataLoader(TensorDataset(x, y), batch_size=settings.batch_size, shuffle=True)
    plain = torch.optim.Adam(theirs.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)

    def loader_epoch() -> None:
        for inputs, targets in batches:
            loss = torch.nn.functional.mse_loss(theirs(inputs), targets)
            plain.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            plain.step()

    generator = torch.Generator().manual_seed(0)
    peers = {"DataLoader loop": (loader_epoch, 1.5, None)}

    def our_epoch() -> None:
        epoch(ours, fused, x, y, settings.batch_size, generator)

    yield from compared("training epoch 256-128", our_epoch, peers, max(3, repeats // 3))

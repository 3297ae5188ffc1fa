"""Fits, filters and training against deap, filterpy and torch's DataLoader."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from bcid.bench.timing import Row, compared
from bcid.estimate import kernel, reference
from bcid.estimate.events import timeline
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.models.interface import FitTask
from bcid.models.network.training import epoch, network, optimiser
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.settings import NewtonEulerSettings, TrainingSettings
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.drive import drive
from bcid.virtual_lab import TUNING, recorded, vehicle

HOUR_S = 3600.0
FILTERED_S = 20.0  # of poses that both filters go through
SAMPLES = 36_000


def hour(seed: int = 1, seconds: float = HOUR_S) -> Estimate:
    """A simulated hour at 10 Hz as the smoother gives it."""
    of = vehicle()
    return estimate_motion(recorded(drive(Plant(**REAL_EXTRAS), Sensor(), seconds, seed), 60.0, of), of, TUNING)


def white_box(repeats: int) -> Iterator[Row]:
    """Least squares from several starts against a hundred generations on the same objective, once each.

    `difference` is by how much the least squares' NMSE is above the genetic algorithm's: not at all where negative.
    """
    take, of = hour(), vehicle()
    settings = NewtonEulerSettings().model_dump()
    small = settings | {"generations": 1, "starts": 1, "population": 10}
    found: dict[str, tuple[float, float]] = {}
    for way in ("levenberg-marquardt", "genetic"):
        NewtonEuler.fit(FitTask([hour(2, 60.0)], of, small | {"optimiser": way}, 1))  # compiles and imports
        begin = time.perf_counter()
        model = NewtonEuler.fit(FitTask([take], of, settings | {"optimiser": way}, 1))
        found[way] = 1e3 * (time.perf_counter() - begin), model.facts["nmse"]
    (ours, mine), (peer, theirs) = found["levenberg-marquardt"], found["genetic"]
    yield Row("fit newton-euler, an hour", "deap, 100 generations", ours, peer, 30.0, mine / theirs - 1.0, 0.0)


def filters(repeats: int) -> Iterator[Row]:
    """The extended Kalman filter and its smoother."""
    of = vehicle()
    recording = recorded(drive(Plant(**REAL_EXTRAS), Sensor(dropouts_per_minute=0.0), FILTERED_S, 1), 60.0, of)
    events = timeline(recording, of, 0.1, 0.3, TUNING.T_s, TUNING.d).events
    chassis, Q, R = TUNING.chassis(of), TUNING.noise.Q(), TUNING.noise.R()
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

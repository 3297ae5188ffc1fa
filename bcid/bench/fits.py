"""Times of fits, filters and training beside those of deap, filterpy and torch's DataLoader."""

import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from bcid.bench.limits import SPEED
from bcid.bench.timing import Timing, time_against_peers
from bcid.estimate import kernel
from bcid.estimate.events import build_chassis, build_timeline
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.models.interface import FitTask
from bcid.models.network.training import build_adam, build_perceptron, train_epoch
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.settings import NewtonEulerSettings, TrainingSettings
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

HOUR_S = 3600.0
FILTERED_S = 20.0  # s of poses that both filters work on
SAMPLES = 36_000  # of an hour at 10 Hz


def simulate_motion(seed: int = 1, seconds: float = HOUR_S) -> Estimate:
    """Smoothed motion (twists and states at 10 Hz) of a simulated drive of `seconds`, estimated from poses at 60 Hz.

    The simulated car has REAL_EXTRAS: bearing drag, soft tyres, a rough floor and a rear axle that no model describes.
    """
    vehicle, drive = simulated_vehicle(), simulate_drive(Plant(**REAL_EXTRAS), Sensor(), seconds, seed)
    return estimate_motion(record_drive(drive, 60.0, vehicle), vehicle, TUNING)


def time_white_box_fit(repeats: int) -> Iterator[Timing]:
    """Yield one timing: a Newton-Euler fit to a simulated hour by Levenberg-Marquardt against deap's genetic algorithm.

    Each fit is timed once, whatever `repeats`.  The timing's `difference` is NMSE of Levenberg-Marquardt / NMSE of the
    genetic algorithm - 1.
    """
    take, vehicle = simulate_motion(), simulated_vehicle()
    settings = NewtonEulerSettings().model_dump()
    small = settings | {"generations": 1, "starts": 1, "population": 10}
    results: dict[str, tuple[float, float]] = {}
    for optimiser in ("levenberg-marquardt", "genetic"):
        # a small fit compiles and imports first
        NewtonEuler.fit(FitTask([simulate_motion(2, 60.0)], vehicle, small | {"optimiser": optimiser}, 1))
        begin = time.perf_counter()
        model = NewtonEuler.fit(FitTask([take], vehicle, settings | {"optimiser": optimiser}, 1))
        results[optimiser] = 1e3 * (time.perf_counter() - begin), model.facts["nmse"]
    (ours, our_nmse), (peer, peer_nmse) = results["levenberg-marquardt"], results["genetic"]
    yield Timing(
        "fit newton-euler, an hour", "deap, 100 generations", ours, peer, SPEED.deap_fit, our_nmse / peer_nmse - 1.0,
        SPEED.max_nmse_excess,
    )  # fmt: skip


def time_filters(repeats: int) -> Iterator[Timing]:
    """Yield timings of our compiled extended Kalman filter and RTS smoother against filterpy's, on 20 s of poses.

    Times are medians of `repeats` turns; `difference` is the largest between the two results, over all states.
    """
    from bcid.estimate import reference

    vehicle = simulated_vehicle()
    drive = simulate_drive(Plant(**REAL_EXTRAS), Sensor(dropouts_per_minute=0.0), FILTERED_S, 1)
    T_s, d, noise = TUNING.T_s, TUNING.d, TUNING.noise
    events = build_timeline(record_drive(drive, 60.0, vehicle), vehicle, 0.1, 0.3, T_s, d).events
    task = events, build_chassis(vehicle, T_s, d), noise.Q(), noise.R()
    ours, theirs = kernel.run_filter(*task), reference.run_filter(*task)
    off = float(np.abs(ours.x - theirs.x).max())
    peer = partial(reference.run_filter, *task), SPEED.filterpy_filter, off
    yield from time_against_peers("EKF", partial(kernel.run_filter, *task), {"filterpy": peer}, repeats)
    smooth = ours, events.restart
    off = float(np.abs(kernel.run_smoother(*smooth)[0] - reference.run_smoother(*smooth)[0]).max())
    smoother_peer = partial(reference.run_smoother, *smooth), SPEED.filterpy_smoother, off
    yield from time_against_peers(
        "RTS smoother", partial(kernel.run_smoother, *smooth), {"filterpy": smoother_peer}, repeats
    )


def time_training_epoch(repeats: int) -> Iterator[Timing]:
    """Yield the timing of an epoch of training a perceptron in torch: batches of tensors against torch's DataLoader.

    Both train on 36 000 random samples, as many as an hour has at 10 Hz, in max(3, repeats // 3) turns each.
    """
    import torch
    from torch.utils.data import DataLoader, TensorDataset

    torch.set_num_threads(1)
    settings = TrainingSettings()
    rng = np.random.default_rng(0)
    x, y = (torch.tensor(rng.standard_normal((SAMPLES, n)), dtype=torch.float32) for n in (6, 3))
    ours, theirs = (build_perceptron(6, settings, 3) for _ in range(2))
    fused = build_adam(ours, settings)
    batches = DataLoader(TensorDataset(x, y), batch_size=settings.batch_size, shuffle=True)
    plain = torch.optim.Adam(theirs.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)

    def loader_epoch() -> None:
        for inputs, targets in batches:
            loss = torch.nn.functional.mse_loss(theirs(inputs), targets)
            plain.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            plain.step()

    peers = {"DataLoader loop": (loader_epoch, SPEED.data_loader_epoch, None)}
    our_epoch = partial(train_epoch, ours, fused, x, y, settings.batch_size, torch.Generator().manual_seed(0))
    yield from time_against_peers("training epoch 256-128", our_epoch, peers, max(3, repeats // 3))

"""Times of fits and training beside those of deap, scipy and torch's DataLoader."""

import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from bcid.aliases import Floats
from bcid.bench.limits import SPEED
from bcid.bench.timing import Skipped, TimedPeer, Timing, Work, require, time_against_peers
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.models.fitting.levenberg_marquardt import FINAL_TOLERANCE, minimise_squares
from bcid.models.fitting.windows import cut_windows, inverse_spread
from bcid.models.interface import FitTask
from bcid.models.network.training import build_adam, build_perceptron, train_epoch
from bcid.models.newton_euler.fit_to_twists import TwistObjective
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.objective import TransposedWindows
from bcid.models.newton_euler.parameters import ConstantBox
from bcid.models.settings import NewtonEulerSettings, TrainingSettings
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

HOUR_S = 3600.0
# Driving (s), and the top speed (m/s) in it, that one descent fits a car to.
SHORT_S, TOP_SPEED_MPS = 1200.0, 2.0
SAMPLES = 36_000  # of an hour at 10 Hz


def simulate_motion(seed: int = 1, seconds: float = HOUR_S) -> Estimate:
    """Smoothed motion (twists and states at 10 Hz) of a simulated drive of `seconds`, estimated from poses at 60 Hz.

    The simulated car has REAL_EXTRAS: bearing drag, soft tyres, a rough floor and a rear axle that no model describes.
    """
    vehicle, drive = simulated_vehicle(), simulate_drive(Plant(**REAL_EXTRAS), Sensor(), seconds, seed)
    return estimate_motion(record_drive(drive, 60.0, vehicle), vehicle, TUNING)


def time_white_box_fit(repeats: int) -> Iterator[Timing | Skipped]:
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
        begin = time.process_time()
        model = NewtonEuler.fit(FitTask([take], vehicle, settings | {"optimiser": optimiser}, 1))
        results[optimiser] = 1e3 * (time.process_time() - begin), model.facts["nmse"]
    (ours, our_nmse), (peer, peer_nmse) = results["levenberg-marquardt"], results["genetic"]
    yield Timing(
        "fit newton-euler, an hour", "deap, 100 generations", ours, peer, SPEED.deap_fit, our_nmse / peer_nmse - 1.0,
        SPEED.max_nmse_excess,
    )  # fmt: skip


def time_least_squares(repeats: int) -> Iterator[Timing | Skipped]:
    """Yield the timing of one descent to a car's constants: ours against scipy's least squares on the same residuals.

    Both start in the middle of the constants' ranges.  Ours first descends on a part of SHORT_S (s) of driving, and
    hands scipy a small problem of equal curvature; the peer hands it all residuals.  Times are medians of
    max(3, repeats // 3) turns; `difference` is that of the least NMSE.
    """
    take, settings = simulate_motion(1, SHORT_S), NewtonEulerSettings()
    windows = cut_windows([take], 1, 1)
    box = ConstantBox(simulated_vehicle(), *take.steering_constants(), settings.v_0_mps, TOP_SPEED_MPS)
    stretches = TransposedWindows.from_windows(windows, take.period_s)
    objective = TwistObjective(box, stretches, inverse_spread(windows.twist[:, 0]))
    part, middle = objective.subset(settings.subset, 1), np.full(len(box.constants), 0.5)

    def ours() -> float:
        found = minimise_squares(part.normal_equations, objective.normal_equations, [middle], lambda share, text: None)
        return found.cost

    def by_scipy() -> Work:
        require("scipy")
        from scipy.optimize import least_squares

        def residuals(x: Floats) -> Floats:
            return np.asarray(objective.residuals(x[None])[0])

        return lambda: (
            2.0
            * least_squares(
                residuals, middle, objective.jacobian, bounds=(0.0, 1.0), xtol=FINAL_TOLERANCE, ftol=FINAL_TOLERANCE
            ).cost
        )

    peers = {"scipy least_squares": TimedPeer(by_scipy, SPEED.scipy_fit, SPEED.max_nmse_difference)}
    yield from time_against_peers("fit newton-euler, 20 min, one start", ours, peers, max(3, repeats // 3))


def time_training_epoch(repeats: int) -> Iterator[Timing | Skipped]:
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

    peers = {"DataLoader loop": TimedPeer(lambda: loader_epoch, SPEED.data_loader_epoch)}
    our_epoch = partial(train_epoch, ours, fused, x, y, settings.batch_size, torch.Generator().manual_seed(0))
    yield from time_against_peers("training epoch 256-128", our_epoch, peers, max(3, repeats // 3))

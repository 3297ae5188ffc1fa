"""Training a perceptron in torch: on single steps (paper, App. mlp), then, if asked, on whole rollouts.

The rollout loss is what reports quote: the squared error of the twist, over many steps of the model's own state.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.aliases import Floats
from bcid.models.fitting import windows
from bcid.models.interface import FitTask
from bcid.models.network.mlp import MlpWeights
from bcid.models.settings import TrainingSettings

if TYPE_CHECKING:
    from torch import Tensor

Network = Callable[["Tensor"], "Tensor"]
"""Maps inputs (B, n) in their units to outputs (B, m) in theirs."""

RolloutFunction = Callable[[Network, "Tensor", "Tensor", "Tensor"], "Tensor"]
"""Maps a network, twists, kinematic states and commands of stretches as `Windows` has them, to the twists (B, S, 3)
after each step; the kinematic states hold the steering angles as the servo alone determines them."""

MAX_GRADIENT_NORM = 1.0  # longer ones are shortened: a rollout near divergence has no useful slope
STARTS_PER_STRETCH = 4  # stretches that begin within the length of one: every fourth of them holds each sample once
MIN_STRETCHES_PER_EPOCH = 256  # fewer make too few steps in all: after two a minute's take is hardly trained on


def train_perceptron(
    task: FitTask, settings: TrainingSettings, mapping: Callable[[windows.SingleSteps], tuple[Floats, Floats]],
    rollout: RolloutFunction, lags: int = 0, prepare: Callable[[windows.Windows], windows.Windows] = lambda w: w,
) -> tuple[MlpWeights, dict[str, Any]]:  # fmt: skip
    """Train a perceptron with two hidden layers on the recordings of `task`: its weights, and the losses of the epochs.

    First on single steps: the mean squared error of the normalised output (paper, lossv with W = 1/sigma) by Adam
    with weight decay and dropout; every `decay_epochs` epochs the learning rate is multiplied by `decay_factor`.
    Then, if the settings' loss is "rollout", on the error of the twist that `rollout` predicts over stretches; the
    recordings' ends are held out to choose the epoch (early stopping).

    `mapping` turns single steps into inputs (N, n) and outputs (N, m); `lags` counts the rows before a start that the
    model needs; `prepare` changes the stretches before rollouts are compared with them.
    """
    import torch
    from torch import nn

    training, stretches = list(task.estimates), list[windows.Windows]()
    if settings.loss == "rollout":
        steps = windows.loss_steps(settings.loss, settings.horizon_s, task.period_s)
        training, ends = windows.split_off_ends(task.estimates, lags + 1 + steps)
        every = max(1, steps // STARTS_PER_STRETCH)
        stretches = [prepare(windows.cut_windows(takes, steps, every, lags)) for takes in (training, ends)]
    x, y = mapping(windows.single_steps(training, lags))
    torch.set_num_threads(1)  # networks this small lose time on more
    (x_mean, x_sd), (y_mean, y_sd) = moments = [(v.mean(axis=0), windows.column_spread(v)) for v in (x, y)]
    with torch.random.fork_rng():
        torch.manual_seed(task.seed)
        net = build_perceptron(x.shape[1], settings, y.shape[1])
        normalised = (x - x_mean) / x_sd, (y - y_mean) / y_sd
        inputs, targets = (torch.tensor(v, dtype=torch.float32) for v in normalised)
        losses = _train_on_single_steps(net, inputs, targets, settings, task)
        facts: dict[str, Any] = {"loss": settings.loss, "epochs": settings.epochs, "losses": losses}
        if stretches:
            facts |= _train_on_rollouts(net, moments, rollout, stretches, settings, task)
    layers = [layer for layer in net if isinstance(layer, nn.Linear)]
    W1, b1, W2, b2, W3, b3 = (
        np.ascontiguousarray(a.detach().numpy().T) for layer in layers for a in (layer.weight, layer.bias)
    )
    return MlpWeights(x_mean, x_sd, W1, b1, W2, b2, W3, b3, y_mean, y_sd), facts


def build_perceptron(inputs: int, settings: TrainingSettings, outputs: int) -> Any:
    """Build an untrained torch network of two hidden ReLU layers of sizes `settings.hidden`, each with dropout."""
    from torch import nn

    first, second = settings.hidden
    return nn.Sequential(
        nn.Linear(inputs, first), nn.ReLU(), nn.Dropout(settings.dropout),
        nn.Linear(first, second), nn.ReLU(), nn.Dropout(settings.dropout),
        nn.Linear(second, outputs),
    )  # fmt: skip


def _train_on_single_steps(
    net: Any, inputs: Tensor, targets: Tensor, settings: TrainingSettings, task: FitTask
) -> list[float]:
    """Train `net` on normalised single steps, `inputs` (N, n) and `targets` (N, m), for the epochs of the settings.

    Returns the mean squared errors of the epochs, thinned to fewer than 200.
    """
    import torch

    generator = torch.Generator().manual_seed(task.seed)
    adam = build_adam(net, settings)
    schedule = torch.optim.lr_scheduler.StepLR(adam, settings.decay_epochs, settings.decay_factor)
    losses = []
    share = 1.0 if settings.loss == "one-step" else 0.5
    for k in range(settings.epochs):
        losses.append(train_epoch(net, adam, inputs, targets, settings.batch_size, generator))
        schedule.step()
        task.progress(share * (k + 1) / settings.epochs, f"epoch {k + 1}, loss {losses[-1]:.2e}")
    return losses[:: max(1, len(losses) // 100)]


def build_adam(net: Any, settings: TrainingSettings) -> Any:
    """Build torch's Adam optimiser for the parameters of `net`, with the settings' learning rate and weight decay."""
    import torch

    return torch.optim.Adam(net.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True)


def train_epoch(net: Any, optimiser: Any, inputs: Tensor, targets: Tensor, batch_size: int, generator: Any) -> float:
    """Train `net` for one epoch in random batches drawn by `generator`; return the mean squared error of its batches.

    Batches are rows of tensors in memory, since a DataLoader would gather samples one by one.
    """
    import torch

    total = 0.0
    for rows in torch.randperm(len(inputs), generator=generator).split(batch_size):  # type: ignore[no-untyped-call]
        loss = torch.nn.functional.mse_loss(net(inputs[rows]), targets[rows])
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        total += float(loss.detach()) * len(rows)
    return total / len(inputs)


def _train_on_rollouts(
    net: Any, moments: Any, rollout: RolloutFunction, stretches: Sequence[windows.Windows], settings: TrainingSettings,
    task: FitTask,
) -> dict[str, Any]:  # fmt: skip
    """Train `net` further on the twist's error in rollouts, without dropout; restore its best epoch, return the losses.

    `stretches` are two sets: one to train on, one held out, whose error chooses the best epoch; `moments` are (mean,
    standard deviation) of the inputs and of the outputs.  The learning rate falls to zero as half a cosine; each
    epoch draws a random 1/STARTS_PER_STRETCH of the training stretches, of short takes at least
    MIN_STRETCHES_PER_EPOCH or all.
    """
    import torch

    (x_mean, x_sd), (y_mean, y_sd) = ((torch.tensor(v, dtype=torch.float32) for v in pair) for pair in moments)

    def network(x: Tensor) -> Tensor:
        return y_mean + y_sd * net((x - x_mean) / x_sd)  # type: ignore[no-any-return]

    weight = torch.tensor(windows.inverse_spread(stretches[0].twist[:, 0]), dtype=torch.float32)
    training, validation = (
        [torch.tensor(c, dtype=torch.float32) for c in (w.twist, w.kinematic, w.command)] for w in stretches
    )
    count, steps = stretches[0].stretch_count, stretches[0].steps

    def loss_of(twist: Tensor, kinematic: Tensor, command: Tensor) -> Tensor:
        error = rollout(network, twist, kinematic, command) - twist[:, -steps:]
        return ((weight * error) ** 2).mean()

    generator = torch.Generator().manual_seed(task.seed + 1)
    net.eval()
    adam = torch.optim.Adam(net.parameters(), lr=settings.rollout_learning_rate, fused=True)
    per_epoch = min(count, max(count // STARTS_PER_STRETCH, MIN_STRETCHES_PER_EPOCH))

    def validation_loss() -> float:
        with torch.no_grad():
            return float(loss_of(*(c[::STARTS_PER_STRETCH] for c in validation)))

    best, least, history = copy.deepcopy(net.state_dict()), validation_loss(), list[float]()
    for epoch in range(settings.rollout_epochs):
        for group in adam.param_groups:
            fall = math.cos(math.pi * epoch / settings.rollout_epochs)
            group["lr"] = settings.rollout_learning_rate * 0.5 * (1 + fall)
        drawn = torch.randperm(count, generator=generator)[:per_epoch]
        for rows in drawn.split(settings.rollout_batch):  # type: ignore[no-untyped-call]
            loss = loss_of(*(c[rows] for c in training))
            adam.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(net.parameters(), MAX_GRADIENT_NORM)
            adam.step()
        history.append(validation_loss())
        if history[-1] < least:
            best, least = copy.deepcopy(net.state_dict()), history[-1]
        done = (epoch + 1) / settings.rollout_epochs
        task.progress(0.5 + 0.5 * done, f"rollouts {epoch + 1}, loss {history[-1]:.2e}")
    net.load_state_dict(best)
    return {"rollout_epochs": settings.rollout_epochs, "held_out_rollout_loss": least, "rollout_losses": history}

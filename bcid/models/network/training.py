"""Training a perceptron in torch: on single steps (paper, App. mlp), then, if asked, on whole rollouts.

The rollout loss is what reports quote: the squared error of the twist, over many steps of the model's own state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bcid.aliases import Floats, Progress
from bcid.estimate.types import Estimate
from bcid.models.fitting.windows import Windows, divided, scale, spread, steps_of, windows
from bcid.models.interface import FitTask
from bcid.models.network.mlp import Weights
from bcid.models.settings import TrainingSettings

if TYPE_CHECKING:
    from torch import Tensor

Network = Callable[["Tensor"], "Tensor"]  # inputs (B, n) in their units to outputs (B, m) in theirs
Unrolled = Callable[[Network, "Tensor", "Tensor", "Tensor"], "Tensor"]
"""A network, twists, kinematic states and commands of stretches as `Windows` has them, to the twists (B, S, 3) after
each step; the kinematic states hold the steering angles as the servo alone determines them."""

LOUDEST = 1.0  # norm of a gradient, above which it is shortened: a rollout near its limit has no useful slope
EVERY = 4  # of a stretch's length, the distance of neighbouring starts


class Stretches(NamedTuple):
    """What the rollout loss is taken of."""

    used: Windows
    held: Windows  # on which the best epoch is chosen
    unrolled: Unrolled


def parts_of(task: FitTask, settings: TrainingSettings, lags: int = 0) -> tuple[list[Estimate], list[Estimate]]:
    """The takes to train on, and their ends on which the best epoch is chosen; all and none with the one-step loss."""
    if settings.loss == "one-step":
        return list(task.estimates), []
    return divided(task.estimates, lags + 1 + steps_of(settings.loss, settings.horizon_s, task.period_s))


def stretches_of(
    used: Sequence[Estimate], held: Sequence[Estimate], settings: TrainingSettings, unrolled: Unrolled,
    lags: int = 0, prepared: Callable[[Windows], Windows] = lambda taken: taken,
) -> Stretches | None:  # fmt: skip
    """Those of the parts, `prepared`; None with the one-step loss."""
    if not held:
        return None
    steps = steps_of(settings.loss, settings.horizon_s, used[0].period_s)
    first, second = (prepared(windows(part, steps, max(1, steps // EVERY), lags)) for part in (used, held))
    return Stretches(first, second, unrolled)


def _moments(values: Floats) -> tuple[Floats, Floats]:
    return values.mean(axis=0), spread(values)


def train(
    x: Floats, y: Floats, settings: TrainingSettings, seed: int, progress: Progress,
    rollouts: Stretches | None = None,
) -> tuple[Weights, dict[str, Any]]:  # fmt: skip
    """Weights that map `x` (N, n) to `y` (N, m), and the losses of the epochs.

    First the mean squared error of the normalised output (paper, lossv with W = 1/sigma): Adam with weight decay, a
    learning rate that falls by `decay_factor` every `decay_epochs`, dropout while training.  Then, where there are
    stretches, that of their twists in the model's own rollouts.
    """
    import torch
    from torch import nn

    torch.set_num_threads(1)  # nets this small lose time on more
    moments = _moments(x), _moments(y)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = network(x.shape[1], settings, y.shape[1])
        inputs, targets = (_normal(v, m) for v, m in zip((x, y), moments, strict=True))
        losses = _on_single_steps(net, inputs, targets, settings, seed, progress)
        facts: dict[str, Any] = {"loss": settings.loss, "epochs": settings.epochs, "losses": losses}
        if rollouts is not None:
            facts |= _on_rollouts(net, moments, rollouts, settings, seed, progress)
    layers = [layer for layer in net if isinstance(layer, nn.Linear)]
    W1, b1, W2, b2, W3, b3 = (
        np.ascontiguousarray(a.detach().numpy().T) for layer in layers for a in (layer.weight, layer.bias)
    )
    (x_mean, x_sd), (y_mean, y_sd) = moments
    return Weights(x_mean, x_sd, W1, b1, W2, b2, W3, b3, y_mean, y_sd), facts


def _normal(values: Floats, moments: tuple[Floats, Floats]) -> Tensor:
    import torch

    return torch.tensor((values - moments[0]) / moments[1], dtype=torch.float32)


def network(inputs: int, settings: TrainingSettings, outputs: int) -> Any:
    """A perceptron to be trained."""
    from torch import nn

    first, second = settings.hidden
    return nn.Sequential(
        nn.Linear(inputs, first), nn.ReLU(), nn.Dropout(settings.dropout),
        nn.Linear(first, second), nn.ReLU(), nn.Dropout(settings.dropout),
        nn.Linear(second, outputs),
    )  # fmt: skip


def _on_single_steps(
    net: Any, inputs: Tensor, targets: Tensor, settings: TrainingSettings, seed: int, progress: Progress
) -> list[float]:
    """Trains `net`; the losses of at most a hundred epochs."""
    import torch

    generator = torch.Generator().manual_seed(seed)
    adam = optimiser(net, settings)
    schedule = torch.optim.lr_scheduler.StepLR(adam, settings.decay_epochs, settings.decay_factor)
    losses = []
    share = 1.0 if settings.loss == "one-step" else 0.5
    for k in range(settings.epochs):
        losses.append(epoch(net, adam, inputs, targets, settings.batch_size, generator))
        schedule.step()
        progress(share * (k + 1) / settings.epochs, f"epoch {k + 1}, loss {losses[-1]:.2e}")
    return losses[:: max(1, len(losses) // 100)]


def optimiser(net: Any, settings: TrainingSettings) -> Any:
    """Adam with weight decay, its steps fused."""
    import torch

    return torch.optim.Adam(net.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True)


def epoch(net: Any, adam: Any, inputs: Tensor, targets: Tensor, batch_size: int, generator: Any) -> float:
    """One pass over all samples in an order of its own; the mean loss.

    Batches are rows of tensors that lie in memory: a DataLoader would gather them one by one.
    """
    import torch

    total = 0.0
    for rows in torch.randperm(len(inputs), generator=generator).split(batch_size):  # type: ignore[no-untyped-call]
        loss = torch.nn.functional.mse_loss(net(inputs[rows]), targets[rows])
        adam.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        adam.step()
        total += float(loss.detach()) * len(rows)
    return total / len(inputs)


def _on_rollouts(
    net: Any, moments: Any, stretches: Stretches, settings: TrainingSettings, seed: int, progress: Progress
) -> dict[str, Any]:  # fmt: skip
    """Trains `net` further, without dropout, at a rate that falls to nothing; it ends as it was at its best epoch.

    An epoch goes once over as many steps as there are samples, from starts drawn anew.
    """
    import torch

    (x_mean, x_sd), (y_mean, y_sd) = ((torch.tensor(v, dtype=torch.float32) for v in pair) for pair in moments)

    def in_units(at: Tensor) -> Tensor:
        return y_mean + y_sd * net((at - x_mean) / x_sd)  # type: ignore[no-any-return]

    weight = torch.tensor(scale(stretches.used.twist[:, 0]), dtype=torch.float32)
    used, held = ([torch.tensor(c, dtype=torch.float32) for c in w[:3]] for w in stretches[:2])
    steps = stretches.used.steps

    def loss_of(twist: Tensor, kinematic: Tensor, command: Tensor) -> Tensor:
        off = stretches.unrolled(in_units, twist, kinematic, command) - twist[:, -steps:]
        return ((weight * off) ** 2).mean()

    generator = torch.Generator().manual_seed(seed + 1)
    net.eval()
    adam = torch.optim.Adam(net.parameters(), lr=settings.rollout_learning_rate, fused=True)
    count = stretches.used.number
    per_epoch = max(1, count // EVERY)

    def judged() -> float:
        with torch.no_grad():
            return float(loss_of(*(c[::EVERY] for c in held)))

    best, least, history = _copied(net), judged(), list[float]()
    for epoch in range(settings.rollout_epochs):
        for group in adam.param_groups:
            group["lr"] = (
                settings.rollout_learning_rate * 0.5 * (1 + math.cos(math.pi * epoch / settings.rollout_epochs))
            )
        drawn = torch.randperm(count, generator=generator)[:per_epoch]
        for rows in drawn.split(settings.rollout_batch):  # type: ignore[no-untyped-call]
            loss = loss_of(*(c[rows] for c in used))
            adam.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(net.parameters(), LOUDEST)
            adam.step()
        history.append(judged())
        if history[-1] < least:
            best, least = _copied(net), history[-1]
        progress(0.5 + 0.5 * (epoch + 1) / settings.rollout_epochs, f"rollouts {epoch + 1}, loss {history[-1]:.2e}")
    net.load_state_dict(best)
    return {"rollout_epochs": settings.rollout_epochs, "held_out_rollout_loss": least, "rollout_losses": history}


def _copied(net: Any) -> dict[str, Tensor]:
    return {name: value.detach().clone() for name, value in net.state_dict().items()}

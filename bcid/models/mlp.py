"""A multilayer perceptron with two hidden ReLU layers: compiled evaluation, training in torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.compiled import njit
from bcid.models.interface import Arrays, Progress
from bcid.models.settings import TrainingSettings

Floats = npt.NDArray[np.float64]


class Weights(NamedTuple):
    """y = y_mean + y_sd * (W3 relu(W2 relu(W1 (x - x_mean)/x_sd + b1) + b2) + b3), W stored as (in, out)."""

    x_mean: Floats
    x_sd: Floats
    W1: Floats
    b1: Floats
    W2: Floats
    b2: Floats
    W3: Floats
    b3: Floats
    y_mean: Floats
    y_sd: Floats


@njit
def _relu_layer(x: Floats, W: Floats, b: Floats) -> Floats:
    """relu(x W + b); rows of W that meet a zero are skipped."""
    y = b.copy()
    for i in range(len(x)):
        if x[i] != 0.0:
            for j in range(len(y)):
                y[j] += x[i] * W[i, j]
    for j in range(len(y)):
        y[j] = max(y[j], 0.0)
    return y


@njit
def forward(x: Floats, w: Weights) -> Floats:
    """The network's output at one input."""
    hidden = _relu_layer((x - w.x_mean) / w.x_sd, w.W1, w.b1)
    hidden = _relu_layer(hidden, w.W2, w.b2)
    out = w.b3.copy()
    for i in range(len(hidden)):
        if hidden[i] != 0.0:
            for j in range(len(out)):
                out[j] += hidden[i] * w.W3[i, j]
    return w.y_mean + w.y_sd * out


def count(w: Weights) -> int:
    """Weights and biases."""
    return sum(a.size for a in (w.W1, w.b1, w.W2, w.b2, w.W3, w.b3))


def to_arrays(w: Weights) -> Arrays:
    """For safetensors."""
    return {name: np.ascontiguousarray(value) for name, value in w._asdict().items()}


def from_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> Weights:
    """The inverse of `to_arrays`."""
    return Weights(*(np.ascontiguousarray(arrays[name], dtype=float) for name in Weights._fields))


def _moments(values: Floats) -> tuple[Floats, Floats]:
    sd = values.std(axis=0)
    return values.mean(axis=0), np.where(sd > 1e-9, sd, 1.0)


def train(
    x: Floats, y: Floats, settings: TrainingSettings, seed: int, progress: Progress
) -> tuple[Weights, dict[str, Any]]:
    """Weights that map `x` (N, n) to `y` (N, m), and the loss of each epoch.

    Mean squared error of the normalised output (paper, lossv with W = 1/sigma); Adam with weight
    decay, a learning rate that falls by `decay_factor` every `decay_epochs`, dropout while training.
    """
    import torch
    from torch import nn

    torch.set_num_threads(1)  # nets this small lose time on more
    generator = torch.Generator().manual_seed(seed)
    (x_mean, x_sd), (y_mean, y_sd) = _moments(x), _moments(y)
    inputs = torch.tensor((x - x_mean) / x_sd, dtype=torch.float32)
    targets = torch.tensor((y - y_mean) / y_sd, dtype=torch.float32)
    first, second = settings.hidden
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = nn.Sequential(
            nn.Linear(x.shape[1], first), nn.ReLU(), nn.Dropout(settings.dropout),
            nn.Linear(first, second), nn.ReLU(), nn.Dropout(settings.dropout),
            nn.Linear(second, y.shape[1]),
        )  # fmt: skip
        adam = torch.optim.Adam(
            net.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True
        )
        schedule = torch.optim.lr_scheduler.StepLR(adam, settings.decay_epochs, settings.decay_factor)
        losses = []
        for epoch in range(settings.epochs):
            total = 0.0
            for rows in torch.randperm(len(inputs), generator=generator).split(settings.batch_size):  # type: ignore[no-untyped-call]
                loss = nn.functional.mse_loss(net(inputs[rows]), targets[rows])
                adam.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                adam.step()
                total += float(loss.detach()) * len(rows)
            schedule.step()
            losses.append(total / len(inputs))
            progress((epoch + 1) / settings.epochs, f"epoch {epoch + 1}, loss {losses[-1]:.2e}")
    layers = [layer for layer in net if isinstance(layer, nn.Linear)]
    trained = [
        a for layer in layers for a in (layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy())
    ]
    W1, b1, W2, b2, W3, b3 = (a.astype(float) for a in trained)
    weights = Weights(x_mean, x_sd, W1, b1, W2, b2, W3, b3, y_mean, y_sd)
    return weights, {
        "epochs": settings.epochs,
        "final_loss": losses[-1],
        "losses": losses[:: max(1, len(losses) // 100)],
    }

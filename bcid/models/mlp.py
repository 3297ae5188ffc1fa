"""A multilayer perceptron with two hidden ReLU layers, compiled; `bcid.models.training` trains it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.compiled import njit
from bcid.models.interface import Arrays

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

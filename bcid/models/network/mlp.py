"""A multilayer perceptron with two hidden ReLU layers, compiled; `bcid.models.network.training` trains it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats, Singles
from bcid.compiled.njit import njit, njit_inline, njit_sums
from bcid.models.interface import Arrays
from bcid.models.network.sparse_product import add_product

OUTPUTS = 3  # a twist, or [v_f, alpha_f, alpha_r]


class Weights(NamedTuple):
    """y = y_mean + y_sd * (W3 relu(W2 relu(W1 (x - x_mean)/x_sd + b1) + b2) + b3), W stored as (in, out)."""

    x_mean: Floats
    x_sd: Floats
    W1: Singles
    b1: Singles
    W2: Singles
    b2: Singles
    W3: Singles
    b3: Singles
    y_mean: Floats
    y_sd: Floats


class Buffers(NamedTuple):
    """What an evaluation works on: made once for a whole rollout."""

    x: Floats  # (in,) the input, to be filled
    z: Singles  # (in,) the same normalised
    h1: Singles
    h2: Singles
    h3: Singles
    V3: Singles  # W3 turned, a row for each output
    y: Floats  # (out,) the output


@njit
def buffers(w: Weights) -> Buffers:
    """Of a network."""
    n, a, b, m = len(w.x_mean), len(w.b1), len(w.b2), len(w.b3)
    single = np.float32
    return Buffers(
        np.empty(n), np.empty(n, single), np.empty(a, single), np.empty(b, single), np.empty(m, single),
        np.ascontiguousarray(w.W3.T), np.empty(m),
    )  # fmt: skip


@njit_inline
def _copy(of: Singles, to: Singles) -> None:
    """Fills `to`: `to[:] = of` takes fifty nanoseconds, as long as a layer of few inputs."""
    for j in range(len(to)):
        to[j] = of[j]


@njit_sums
def _by_twos(x: Singles, W: Singles, b: Singles, y: Singles) -> None:
    """Fills y with x W + b, two rows of W at a time: for few inputs."""
    whole = len(x) - len(x) % 2
    _copy(b, y)
    for i in range(0, whole, 2):
        for j in range(len(y)):
            y[j] += x[i] * W[i, j] + x[i + 1] * W[i + 1, j]
    for i in range(whole, len(x)):
        for j in range(len(y)):
            y[j] += x[i] * W[i, j]


@njit_sums
def _by_dots(x: Singles, V: Singles, b: Singles, y: Singles) -> None:
    """Fills y with V x + b: for few outputs."""
    for j in range(len(y)):
        total = np.float32(0.0)
        for i in range(len(x)):
            total += x[i] * V[j, i]
        y[j] = b[j] + total


@njit_inline
def _relu(x: Singles) -> None:
    for j in range(len(x)):
        x[j] = max(x[j], np.float32(0.0))


@njit_inline
def evaluate(at: Buffers, w: Weights) -> None:
    """Fills `at.y` with the network's output at `at.x`; single precision but for the units of input and output.

    Rows of W2 that meet a zero, as half of them do behind a ReLU, are skipped.
    """
    for i in range(len(at.x)):
        at.z[i] = np.float32((at.x[i] - w.x_mean[i]) / w.x_sd[i])
    _by_twos(at.z, w.W1, w.b1, at.h1)
    _relu(at.h1)
    _copy(w.b2, at.h2)
    add_product(at.h1, w.W2, at.h2)
    _relu(at.h2)
    _by_dots(at.h2, at.V3, w.b3, at.h3)
    for i in range(len(at.y)):
        at.y[i] = w.y_mean[i] + w.y_sd[i] * at.h3[i]


def count(w: Weights) -> int:
    """Weights and biases."""
    return sum(a.size for a in (w.W1, w.b1, w.W2, w.b2, w.W3, w.b3))


def to_arrays(w: Weights) -> Arrays:
    """For safetensors."""
    return {name: np.ascontiguousarray(value) for name, value in w._asdict().items()}


def from_arrays(arrays: Mapping[str, npt.NDArray[Any]], inputs: int) -> Weights:
    """The inverse of `to_arrays`, of a network with so many inputs and OUTPUTS outputs.

    Raises:
        KeyError: an array is missing.
        ValueError: shapes that make no such network: the kernels look at none.
    """
    given = {name: np.asarray(arrays[name], order="C") for name in Weights._fields}
    x_mean, x_sd, y_mean, y_sd = (given[name].astype(np.float64) for name in ("x_mean", "x_sd", "y_mean", "y_sd"))
    W1, b1, W2, b2, W3, b3 = (given[name].astype(np.float32) for name in ("W1", "b1", "W2", "b2", "W3", "b3"))
    a, b = b1.size, b2.size
    shapes = [(inputs,), (inputs,), (inputs, a), (a,), (a, b), (b,), (b, OUTPUTS), (OUTPUTS,), (OUTPUTS,), (OUTPUTS,)]
    weights = Weights(x_mean, x_sd, W1, b1, W2, b2, W3, b3, y_mean, y_sd)
    if [array.shape for array in weights] != shapes:
        raise ValueError(f"its layers do not make a network of {inputs} inputs and {OUTPUTS} outputs")
    return weights

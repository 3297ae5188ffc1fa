"""A multilayer perceptron with two hidden ReLU layers, compiled; `bcid.models.network.training` trains it."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Singles
from bcid.compiled.njit import njit, njit_inline, njit_sums
from bcid.models.interface import Arrays
from bcid.models.limits import LIMITS
from bcid.models.network.sparse_product import add_product
from bcid.models.saved_parts import ArrayRule, check_arrays

OUTPUTS = 3  # a twist, or [v_f, alpha_f, alpha_r]


class MlpWeights(NamedTuple):
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


class MlpBuffers(NamedTuple):
    """Arrays that an evaluation works on, allocated once for a whole rollout."""

    x: Floats  # (in,) the input, to be filled
    z: Singles  # (in,) the input normalised
    h1: Singles  # the outputs of the three layers
    h2: Singles
    h3: Singles
    V3: Singles  # W3 transposed, a row for each output
    y: Floats  # (out,) the output


@njit
def allocate_buffers(w: MlpWeights) -> MlpBuffers:
    """Allocate the arrays that `evaluate_mlp` works on for the network `w`, once for a whole rollout."""
    n, a, b, m = len(w.x_mean), len(w.b1), len(w.b2), len(w.b3)
    single = np.float32
    return MlpBuffers(
        np.empty(n), np.empty(n, single), np.empty(a, single), np.empty(b, single), np.empty(m, single),
        np.ascontiguousarray(w.W3.T), np.empty(m),
    )  # fmt: skip


@njit_inline
def _copy_vector(source: Singles, target: Singles) -> None:
    """Copy `source` (n,) into `target`: numba's slice assignment takes 50 ns, as long as a layer of few inputs."""
    for j in range(len(target)):
        target[j] = source[j]


@njit_sums
def _multiply_by_row_pairs(x: Singles, W: Singles, b: Singles, y: Singles) -> None:
    """Fill y (m,) with x W + b, two rows of W (n, m) at a time: fast for few inputs."""
    whole = len(x) - len(x) % 2
    _copy_vector(b, y)
    for i in range(0, whole, 2):
        for j in range(len(y)):
            y[j] += x[i] * W[i, j] + x[i + 1] * W[i + 1, j]
    for i in range(whole, len(x)):
        for j in range(len(y)):
            y[j] += x[i] * W[i, j]


@njit_sums
def _multiply_by_dot_products(x: Singles, V: Singles, b: Singles, y: Singles) -> None:
    """Fill y (m,) with V x + b, one row of V (m, n) after the other: fast for few outputs."""
    for j in range(len(y)):
        total = np.float32(0.0)
        for i in range(len(x)):
            total += x[i] * V[j, i]
        y[j] = b[j] + total


@njit_inline
def _apply_relu(x: Singles) -> None:
    """Replace each element x_j of x (n,) by max(x_j, 0), in place."""
    for j in range(len(x)):
        x[j] = max(x[j], np.float32(0.0))


@njit_inline
def evaluate_mlp(buffers: MlpBuffers, w: MlpWeights) -> None:
    """Evaluate the perceptron `w` at the input `buffers.x` (not normalised), and write its output to `buffers.y`.

    Layers compute in single precision.  Rows of W2 whose input is zero, as about half are behind a ReLU, are skipped.
    """
    for i in range(len(buffers.x)):
        buffers.z[i] = np.float32((buffers.x[i] - w.x_mean[i]) / w.x_sd[i])
    _multiply_by_row_pairs(buffers.z, w.W1, w.b1, buffers.h1)
    _apply_relu(buffers.h1)
    _copy_vector(w.b2, buffers.h2)
    add_product(buffers.h1, w.W2, buffers.h2)
    _apply_relu(buffers.h2)
    _multiply_by_dot_products(buffers.h2, buffers.V3, w.b3, buffers.h3)
    for i in range(len(buffers.y)):
        buffers.y[i] = w.y_mean[i] + w.y_sd[i] * buffers.h3[i]


def count_weights(w: MlpWeights) -> int:
    """The number of trained weights and biases of a perceptron, without the means and spreads used to normalise."""
    return sum(a.size for a in (w.W1, w.b1, w.W2, w.b2, w.W3, w.b3))


def describe_layers(w: MlpWeights) -> str:
    """A perceptron's layers in print, such as `hidden 128 and 64, ReLU, 9347 weights`."""
    return f"hidden {len(w.b1)} and {len(w.b2)}, ReLU, {count_weights(w)} weights"


def weights_to_arrays(w: MlpWeights) -> Arrays:
    """A perceptron's weights, biases and normalising means and spreads as arrays by name, for a safetensors file."""
    return {name: np.ascontiguousarray(value) for name, value in w._asdict().items()}


def weights_from_arrays(arrays: Arrays, inputs: int) -> MlpWeights:
    """The perceptron with `inputs` inputs and three outputs that `weights_to_arrays` turned into `arrays`.

    Raises:
        ValueError: an array is missing, unknown, of another type, not finite, or of a shape that does not fit the
            others; checked here, since the compiled kernels check nothing.
    """
    least, most = LIMITS.min_constant, LIMITS.max_constant
    rules = {
        "x_mean": ArrayRule(np.float64, (inputs,), -most, most), "x_sd": ArrayRule(np.float64, (inputs,), least, most),
        "W1": ArrayRule(np.float32, (inputs, "a")), "b1": ArrayRule(np.float32, ("a",)),
        "W2": ArrayRule(np.float32, ("a", "b")), "b2": ArrayRule(np.float32, ("b",)),
        "W3": ArrayRule(np.float32, ("b", OUTPUTS)), "b3": ArrayRule(np.float32, (OUTPUTS,)),
        "y_mean": ArrayRule(np.float64, (OUTPUTS,), -most, most), "y_sd": ArrayRule(np.float64, (OUTPUTS,), 0.0, most),
    }  # fmt: skip
    return MlpWeights(**check_arrays(arrays, rules))

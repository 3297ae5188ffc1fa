"""The rollout loss: what torch unrolls the compiled model drives, and training on it lowers what is reported."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from bcid.estimate.types import Estimate
from bcid.models import published
from bcid.models.fitting.windows import Windows, cut_windows, inverse_spread
from bcid.models.interface import FitTask, history_at, rollout
from bcid.models.kinematic.k_mlp import KMlp
from bcid.models.kinematic.k_sindy_mlp import KSindyMlp
from bcid.models.kinematic.library import SLIP_TERMS, theta_matrix
from bcid.models.kinematic.torch_rollout import build_f_sindy, build_kinematic_rollout, simulate_steering
from bcid.models.network.mlp import MlpWeights, weights_from_arrays
from bcid.models.network.narx_mlp import LAGS, NarxMlp, _rollout_in_torch
from bcid.models.network.training import Network
from bcid.models.table import model_row
from bcid.vehicle import Vehicle

FRAME = published.k_sindy().car
SETTINGS: dict[str, Any] = {"epochs": 8, "learning_rate": 2e-3, "decay_epochs": 4, "hidden": [32, 16],
                            "rollout_epochs": 12, "rollout_learning_rate": 2e-3, "rollout_batch": 8}  # fmt: skip


def weights(inputs: int, seed: int, y_mean: np.ndarray, y_sd: np.ndarray) -> MlpWeights:
    rng = np.random.default_rng(seed)
    sizes = [inputs, 12, 8, 3]
    W1, W2, W3 = (rng.normal(0.0, n**-0.5, (n, m)).astype(np.float32) for n, m in itertools.pairwise(sizes))
    b1, b2, b3 = (rng.normal(0.0, 0.1, m).astype(np.float32) for m in sizes[1:])
    return MlpWeights(np.zeros(inputs), np.ones(inputs), W1, b1, W2, b2, W3, b3, y_mean, y_sd)


def network(w: MlpWeights) -> Network:
    arrays = {name: torch.tensor(value, dtype=torch.float64) for name, value in w._asdict().items()}

    def of(x: torch.Tensor) -> torch.Tensor:
        h = ((x - arrays["x_mean"]) / arrays["x_sd"] @ arrays["W1"] + arrays["b1"]).relu()
        h = (h @ arrays["W2"] + arrays["b2"]).relu()
        return arrays["y_mean"] + arrays["y_sd"] * (h @ arrays["W3"] + arrays["b3"])

    return of


def tensors(taken: Windows) -> list[torch.Tensor]:
    return [torch.tensor(c, dtype=torch.float64) for c in (taken.twist, taken.kinematic, taken.command)]


def test_a_kinematic_rollout_is_the_compiled_one(estimates: list[Estimate]) -> None:
    w = weights(6, 1, np.array([1.0, 0.0, 0.05]), np.array([0.3, 0.2, 0.1]))
    model, take = KMlp(w, FRAME, {}), estimates[0]
    taken = simulate_steering(cut_windows([take], 20, 40), FRAME)
    found = build_kinematic_rollout(FRAME, lambda net, x: net(x))(network(w), *tensors(taken)).numpy()
    for b, start in enumerate(range(0, len(take) - 20, 40)):
        driven = rollout(model, history_at(take, start, 0), take.parts[start : start + 20])
        np.testing.assert_allclose(found[b], driven[1:], atol=2e-5)  # single precision


def test_a_dissipative_rollout_is_the_compiled_one(estimates: list[Estimate]) -> None:
    """Coasting, with a network that pushes: the guarantee is at work in every step."""
    w = weights(6, 3, np.array([0.2, 0.0, 0.0]), np.array([0.05, 0.02, 0.02]))
    sindy, take = published.k_sindy(), estimates[0]
    coasting = replace(take, parts=take.parts * [1.0, 1.0, 0.0, 1.0])
    model, sums = KSindyMlp(sindy, w, {}, True), build_f_sindy(sindy.sparse, FRAME)
    taken = simulate_steering(cut_windows([coasting], 20, 40), FRAME)
    run = build_kinematic_rollout(FRAME, lambda net, x: sums(x.float()).double() + net(x), dissipative=True)
    found = run(network(w), *tensors(taken)).numpy()
    for b, start in enumerate(range(0, len(take) - 20, 40)):
        driven = rollout(model, history_at(coasting, start, 0), coasting.parts[start : start + 20])
        np.testing.assert_allclose(found[b], driven[1:], atol=2e-4)


def test_an_autoregressive_rollout_is_the_compiled_one(estimates: list[Estimate]) -> None:
    w = weights(15, 2, np.array([1.0, 0.0, 0.05]), np.array([0.3, 0.2, 0.1]))
    model, take = NarxMlp(w, 0.1, {}), estimates[0]
    found = _rollout_in_torch(network(w), *tensors(cut_windows([take], 20, 40, LAGS))).numpy()
    for b, start in enumerate(range(LAGS, len(take) - 20, 40)):
        driven = rollout(model, history_at(take, start, LAGS), take.parts[start : start + 20])
        np.testing.assert_allclose(found[b], driven[1:], atol=2e-5)  # single precision


def test_sparse_sums_in_torch_are_the_compiled_ones() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform([0.0, -1.0, -0.5, -1.9, -1.9, -1.0], [2.0, 1.0, 0.5, 1.9, 1.9, 2.0], (50, 6))
    sparse = published.k_sindy().sparse
    found = build_f_sindy(sparse, FRAME)(torch.tensor(x, dtype=torch.float32)).numpy()
    columns = ((sparse.xi_v, sparse.speed), (sparse.xi_f, SLIP_TERMS), (sparse.xi_r, SLIP_TERMS))
    for column, (xi, terms) in zip(found.T, columns, strict=True):
        np.testing.assert_allclose(column, theta_matrix(x, terms, FRAME) @ xi, atol=1e-5)


@pytest.mark.parametrize("name", ["k-mlp", "narx-mlp", "k-sindy-mlp"])
def test_rollouts_lower_what_is_reported(name: str, estimates: list[Estimate], vehicle: Vehicle) -> None:
    """The multi-step error of the training takes, from the same seed."""
    row, errors = model_row(name), []
    base = None
    if row.base:
        base = model_row(row.base).load_class().fit(FitTask(estimates, vehicle, model_row(row.base).defaults, 1))
    weight = inverse_spread(np.concatenate([e.twist for e in estimates]))
    for loss in ("one-step", "rollout"):
        task = FitTask(estimates, vehicle, {**row.defaults, **SETTINGS, "loss": loss}, 1, base)
        model = row.load_class().fit(task)
        off = [
            rollout(model, history_at(e, k, model.lags), e.parts[k : k + 20]) - e.twist[k : k + 21]
            for e in estimates
            for k in range(2, len(e) - 20, 20)
        ]
        errors.append(np.mean((weight * np.concatenate(off)) ** 2))
    assert errors[1] < (0.99 if name == "k-sindy-mlp" else 0.9) * errors[0]  # the sparse part alone is near its best


@pytest.mark.parametrize(("name", "other"), [("W2", (128, 60)), ("b1", (127,)), ("x_mean", (5,)), ("y_sd", (2,))])
def test_layers_that_make_no_network_are_refused(name: str, other: tuple[int, ...]) -> None:
    """The kernels look at no shape."""
    sizes = {"x_mean": (6,), "x_sd": (6,), "W1": (6, 128), "b1": (128,), "W2": (128, 64), "b2": (64,), "W3": (64, 3),
             "b3": (3,), "y_mean": (3,), "y_sd": (3,)}  # fmt: skip
    moments = ("x_mean", "x_sd", "y_mean", "y_sd")
    arrays = {key: np.ones(n, np.float64 if key in moments else np.float32) for key, n in sizes.items()}
    assert weights_from_arrays(arrays, 6).W2.shape == (128, 64)
    with pytest.raises(ValueError, match="has the shape"):
        weights_from_arrays(arrays | {name: np.ones(other, arrays[name].dtype)}, 6)
    with pytest.raises(ValueError, match=r"array x_mean: has the shape \(6,\), not \(15,\)"):
        weights_from_arrays(arrays, 15)

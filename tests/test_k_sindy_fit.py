"""The sparse regression against pysindy's, resamples, the threshold, and coefficients refitted on rollouts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bcid.estimate.types import Estimate
from bcid.models import published
from bcid.models.fitting.windows import inverse_spread
from bcid.models.interface import FitTask, history_at, rollout
from bcid.models.kinematic.k_sindy import KSindy
from bcid.models.kinematic.k_sindy_fit import BlockProducts, stlsq
from bcid.models.kinematic.library import term_name
from bcid.models.kinematic.state import kinematic_twist
from bcid.models.table import model_row
from bcid.vehicle import Vehicle

DEFAULTS = model_row("k-sindy").defaults


def sums(seed: int, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Terms of unit RMS, and a sparse sum of them with noise."""
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n, 8)) @ (np.eye(8) + 0.3 * rng.standard_normal((8, 8)))
    X /= np.sqrt((X**2).mean(axis=0))
    y = X @ np.array([1.0, 0.0, -0.5, 0.0, 0.05, 0.0, 0.0, 0.3]) + 0.05 * rng.standard_normal(n)
    return X, y / np.sqrt((y**2).mean())


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("threshold", [0.0, 0.02, 0.1, 0.3])
def test_thresholding_is_pysindy_s(seed: int, threshold: float) -> None:
    from pysindy.optimizers import STLSQ

    X, y = sums(seed)
    theirs = STLSQ(threshold=threshold, alpha=1e-9, max_iter=50).fit(X, y[:, None]).coef_[0]
    ours = stlsq(X.T @ X / len(X), X.T @ y / len(X), threshold, 1e-9)
    np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_units_do_not_matter() -> None:
    X, y = sums(1)
    units = np.array([1e3, 1.0, 1e-4, 7.0, 1.0, 2.0, 0.1, 50.0])
    plain, scaled = BlockProducts.from_samples(X, y, 20), BlockProducts.from_samples(X * units, 30.0 * y, 20)
    np.testing.assert_allclose(
        scaled.sparse_coefficients(0.1, 1e-9) * units / 30.0, plain.sparse_coefficients(0.1, 1e-9), rtol=1e-6
    )


def test_a_resample_is_the_fit_of_its_rows() -> None:
    X, y = sums(2)
    times = np.array([2.0, 0.0, 1.0, *[1.0] * 17])
    rows = np.r_[0:20, 0:20, 40:400]
    found = BlockProducts.from_samples(X, y, 20).sparse_coefficients(0.05, 1e-9, times)
    np.testing.assert_allclose(
        found, BlockProducts.from_samples(X[rows], y[rows], 20).sparse_coefficients(0.05, 1e-9), rtol=1e-9
    )


def made_by(model: KSindy, take: Estimate) -> Estimate:
    """The take as the model would have driven it: its own truth."""
    states = [take.kinematic[0]]
    for command in take.command[:-1]:
        states.append(model.step(states[-1], command)[0])
    kinematic = np.array(states)
    return replace(take, kinematic=kinematic, twist=np.array([kinematic_twist(tuple(s), model.car) for s in kinematic]))


def fitted(estimates: list[Estimate], vehicle: Vehicle, **settings: Any) -> KSindy:
    return KSindy.fit(FitTask(estimates, vehicle, {**DEFAULTS, "library": "published", **settings}, 1))


def test_equations_are_found_again_and_told_as_sure(estimates: list[Estimate], vehicle: Vehicle) -> None:
    """With nothing but the model's own sum in the data, and no threshold, every coefficient comes back."""
    truth = published.k_sindy()
    takes = [made_by(truth, e) for e in estimates]
    found = fitted(takes, vehicle, threshold=0.0)
    np.testing.assert_allclose(found.sparse.xi_f, truth.sparse.xi_f, atol=1e-6)
    np.testing.assert_allclose(found.sparse.xi_r, truth.sparse.xi_r, atol=1e-6)
    np.testing.assert_allclose(found.sparse.xi_v, truth.sparse.xi_v, atol=0.03)  # v_f stays at zero or above
    chosen = fitted(takes, vehicle)
    assert chosen.facts["threshold"] == float(chosen.facts["threshold"])
    assert chosen.facts["thresholds"][f"{chosen.facts['threshold']:g}"] < 1e-3
    sure = chosen.facts["term_confidence"]["α_f"]
    assert sure["α_f"][0] == 1.0
    assert sure["α_f"][1] <= 0.777 + 2e-3
    assert any(line.split()[:3] == ["α_f", "α_f", "100"] for line in chosen.describe().splitlines())


def test_intervals_are_those_of_the_coefficients_that_rollouts_gave(
    estimates: list[Estimate], vehicle: Vehicle
) -> None:
    """Noise on what is seen of a model's own drives: its coefficients lie in their intervals, most of them."""
    truth, rng = published.k_sindy(), np.random.default_rng(4)
    takes = []
    for take in (made_by(truth, e) for e in estimates):
        seen = take.kinematic + rng.standard_normal(take.kinematic.shape) * [2e-3, 1e-3, 1e-3, 0.0]
        twist = np.array([kinematic_twist(tuple(s), truth.car) for s in seen])
        takes.append(replace(take, kinematic=seen, twist=twist))
    model = fitted(takes, vehicle, loss="rollout", threshold=0.01)
    inside, held = [], []
    for i, (name, terms) in enumerate(
        (("v_f", model.sparse.speed), ("α_f", model.sparse.slip), ("α_r", model.sparse.slip))
    ):
        for e, value, true in zip(terms, model.sparse[i], truth.sparse[i], strict=True):
            if value != 0.0:
                _, low, high = model.facts["term_confidence"][name][term_name(e)]
                inside.append(low < value < high)
                held.append(low < true < high)
    assert all(inside)
    assert np.mean(held) > 0.7


def test_rollouts_lower_what_is_reported(estimates: list[Estimate], vehicle: Vehicle) -> None:
    weight, errors = inverse_spread(np.concatenate([e.twist for e in estimates])), []
    for loss in ("one-step", "rollout"):
        model = fitted(estimates, vehicle, loss=loss, library="vanishing", threshold=0.02)
        off = [
            rollout(model, history_at(e, k, 0), e.parts[k : k + 20]) - e.twist[k : k + 21]
            for e in estimates
            for k in range(0, len(e) - 20, 20)
        ]
        errors.append(np.mean((weight * np.concatenate(off)) ** 2))
    assert errors[1] < 0.9 * errors[0]

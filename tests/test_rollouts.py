"""Many vehicles at once: the batched rollout is each vehicle's own, and what diverges is told."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest
from faults.saved import unnamed_part
from hypothesis import given
from hypothesis import strategies as st

from bcid.effects.constants import Constants
from bcid.estimate.types import Estimate
from bcid.models import published
from bcid.models.interface import Model, RolloutDiverged, history_at, history_at_rest, rollout, rollout_batch
from bcid.models.kinematic.k_mlp import KMlp
from bcid.models.kinematic.k_sindy_mlp import KSindyMlp
from bcid.models.kinematic.state import doubled_energy
from bcid.models.network.mlp import MlpWeights
from bcid.models.network.narx_mlp import NarxMlp
from bcid.models.network.sparse_product import add_product
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.linear import NewtonEulerLinear
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder

RNG = np.random.default_rng(0)


def weights(inputs: int) -> MlpWeights:
    W1, W2, W3 = (RNG.normal(0.0, n**-0.5, (n, m)).astype(np.float32) for n, m in ((inputs, 12), (12, 8), (8, 3)))
    return MlpWeights(np.zeros(inputs), np.ones(inputs), W1, np.zeros(12, np.float32), W2, np.zeros(8, np.float32),
                   W3, np.zeros(3, np.float32),
                   np.array([1.0, 0.0, 0.05]), np.array([0.3, 0.2, 0.1]))  # fmt: skip


SINDY = published.k_sindy()
MODELS: dict[str, Model] = {
    "newton-euler": published.newton_euler(),
    "newton-euler-linear": NewtonEulerLinear(published.newton_euler().car, 1.2, 0.1),
    "narx-mlp": NarxMlp(weights(15), 0.1, {}),
    "k-mlp": KMlp(weights(6), SINDY.car, {}),
    "k-sindy": SINDY,
    "newton-euler-augmented": AugmentedNewtonEuler(
        published.newton_euler().car, {"motor_delay__tau": 0.17}, Constants(), 2.012, 60.0, 0.1, {}
    ),
    "newton-euler-remainder": NewtonEulerWithRemainder(
        AugmentedNewtonEuler(published.newton_euler().car, {}, Constants(), 2.012, 60.0, 0.1, {}), unnamed_part()
    ),
    "k-sindy-mlp": KSindyMlp(SINDY, weights(6)._replace(y_mean=np.zeros(3), y_sd=np.full(3, 0.02)), {}),
}
every_model = pytest.mark.parametrize("name", list(MODELS))


@every_model
@pytest.mark.parametrize("count", [1, 7, 600])
def test_a_batch_is_each_vehicle_alone(name: str, count: int, estimates: list[Estimate]) -> None:
    """600 are more than advance abreast; a few of them are checked, the last ones too."""
    model, take = MODELS[name], estimates[0]
    starts = np.random.default_rng(1).integers(5, len(take) - 60, count)
    carries = np.stack([model.init(history_at(take, int(k), model.lags)) for k in starts])
    commands = np.stack([take.command[k : k + 50] for k in starts])
    twists, diverged_at = rollout_batch(model, carries, commands)
    assert (diverged_at == -1).all()
    for b in {0, count // 2, count - 1, min(count - 1, 256)}:
        np.testing.assert_allclose(twists[b], model.scan(carries[b], commands[b])[1], rtol=0.0, atol=1e-9)


def test_single_precision_is_taken_where_its_error_is_accepted() -> None:
    """Forward and backward, front and rear driven, 600 cars and one; and only by models that have it."""
    rng = np.random.default_rng(3)
    base = published.newton_euler()
    for car in (base.car, base.car._replace(front_share=0.3, sets_force=1.0, u_0=0.1, K_v=40.0, reverses=1.0)):
        model = NewtonEuler(car._replace(R_2=4.0), 0.1, {})
        carries = rng.normal([1.0, 0.0, 0.0, 0.0], [0.5, 0.1, 0.3, 0.5], (600, 4))
        commands = rng.uniform([-1.5, -1.0], [1.5, 2.0], (600, 40, 2))
        exact = rollout_batch(model, carries, commands).twist
        np.testing.assert_array_equal(rollout_batch(model, carries, commands, 9e-6).twist, exact)
        single = rollout_batch(model, carries, commands, 1e-5).twist
        assert 0.0 < np.abs(single - exact).max() < 1e-5
        one = rollout_batch(model, carries[:1], commands[:1], 1e-5).twist
        np.testing.assert_allclose(one, single[:1], rtol=0.0, atol=1e-6)
    carries, commands = np.stack([SINDY.init(history_at_rest(0))] * 3), np.tile([0.3, 1.5], (3, 9, 1))
    np.testing.assert_array_equal(
        rollout_batch(SINDY, carries, commands, 1.0).twist, rollout_batch(SINDY, carries, commands).twist
    )


def test_cars_abreast_take_each_its_own_parts() -> None:
    """Of any length, also none, with a brake of its own."""
    rng, model = np.random.default_rng(4), NewtonEuler(published.newton_euler().car._replace(R_2=4.0), 0.1, {})
    carries, parts = rng.normal([1.0, 0.0, 0.0, 0.0], 0.1, (300, 4)), rng.uniform(0.0, 1.0, (300, 20, 3, 4))
    parts[..., 0] *= 0.1 / parts[..., 0].sum(axis=2, keepdims=True)
    parts[::2, :, 1:, 0], parts[::2, :, 0, 0] = 0.0, 0.1
    after, twists = model.scan_many(carries, parts)
    for b in (0, 1, 150, 299):
        alone_after, alone = model.scan(carries[b], parts[b])
        np.testing.assert_allclose(twists[b], alone, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(after[b], alone_after, rtol=0.0, atol=1e-12)


@every_model
def test_a_rollout_goes_on_where_it_was_left(name: str, estimates: list[Estimate]) -> None:
    model, take = MODELS[name], estimates[0]
    carry = model.init(history_at(take, 40, model.lags))
    whole, commands = model.scan(carry, take.command[40:90])[1], take.command[40:90]
    half, first = model.scan(carry, commands[:20])
    carries, second = model.scan_many(np.tile(half, (3, 1)), np.tile(commands[20:40], (3, 1, 1)))
    _, third = model.scan(carries[2], commands[40:])
    np.testing.assert_array_equal(np.vstack([first, second[1], third]), whole)


@every_model
def test_a_vehicle_that_diverges_is_told_and_harms_no_other(name: str) -> None:
    model = MODELS[name]
    carries = np.stack([model.init(history_at_rest(model.lags))] * 5)
    commands = np.tile([0.3, 1.5], (5, 30, 1))
    alone = rollout_batch(model, carries, commands).twist
    carries[3] = np.nan
    commands[1, 12, 0] = np.nan
    found = rollout_batch(model, carries, commands)
    assert np.isfinite(found.twist).all()
    assert found.diverged_at[3] == 0
    assert (found.twist[3] == 0.0).all()
    assert 12 <= found.diverged_at[1] <= 13
    first = found.diverged_at[1]
    np.testing.assert_array_equal(found.twist[1, first:], np.tile(found.twist[1, first - 1], (30 - first, 1)))
    rest: Any = [0, 2, 4]
    np.testing.assert_array_equal(found.twist[rest], alone[rest])
    assert (found.diverged_at[rest] == -1).all()


class RunsAway:
    """A model whose speed grows tenfold a step: finite, and no vehicle's."""

    name, lags = "runs-away", 0

    def init(self, history: Any) -> np.ndarray:
        return np.array([0.5])

    def scan(self, carry: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        speed = carry * 10.0 ** (1.0 + np.arange(len(commands)))
        return speed[-1:], np.column_stack([speed, 0.0 * speed, 0.0 * speed])

    def scan_many(self, carries: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        each = [self.scan(carry, own) for carry, own in zip(carries, commands, strict=True)]
        return np.stack([e[0] for e in each]), np.stack([e[1] for e in each])


def test_a_speed_that_no_vehicle_has_is_divergence() -> None:
    model: Any = RunsAway()
    with pytest.raises(RolloutDiverged) as caught:
        rollout(model, history_at_rest(0), np.zeros((6, 2)))
    assert caught.value.step == 3  # 500 m/s
    found = rollout_batch(model, np.array([[0.5], [1e-6]]), np.zeros((2, 6, 2)))
    assert found.diverged_at.tolist() == [2, -1]
    assert found.twist[0, :, 0].tolist() == [5.0, 50.0, 50.0, 50.0, 50.0, 50.0]


@given(
    v_f=st.floats(0.0, 3.0), alpha=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.2, 1.2)), delta=st.floats(-2.0, 2.0),
    u_s=st.floats(-2.0, 2.0), u_m=st.floats(-1.0, 0.0), seed=st.integers(0, 20),
)  # fmt: skip
def test_a_dissipative_model_gains_no_energy_without_throttle(
    v_f: float, alpha: tuple[float, float], delta: float, u_s: float, u_m: float, seed: int
) -> None:
    """Whatever its network says, wherever it starts; with throttle it is the plain model."""
    W1, W2, W3 = (
        np.random.default_rng(seed).normal(0.0, 0.5, s).astype(np.float32) for s in ((6, 12), (12, 8), (8, 3))
    )
    wild = weights(6)._replace(W1=W1, W2=W2, W3=W3, y_mean=np.array([0.3, 0.0, 0.0]), y_sd=np.full(3, 0.5))
    tame, plain = (KSindyMlp(SINDY, wild, {}, dissipative) for dissipative in (True, False))
    state = np.array([v_f, *alpha, delta])
    energies = [doubled_energy(tuple(state), SINDY.car)]
    for _ in range(5):
        state, _ = tame.step(state, np.array([u_s, u_m]))
        energies.append(doubled_energy(tuple(state), SINDY.car))
    assert (np.diff(energies) <= np.finfo(float).tiny).all()  # below it, numbers have no digits left
    driven = np.array([u_s, 1.5])
    np.testing.assert_array_equal(tame.step(state, driven)[0], plain.step(state, driven)[0])


def test_the_plain_model_would_gain_energy() -> None:
    """What the guarantee is for."""
    pushing = weights(6)._replace(y_mean=np.array([0.3, 0.0, 0.0]), y_sd=np.zeros(3))
    start, coasting = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros((10, 2))
    tame, plain = (KSindyMlp(SINDY, pushing, {}, d).scan(start, coasting)[1] for d in (True, False))
    assert plain[-1, 0] > 1.5
    assert tame[-1, 0] <= 1.0


@numba.njit
def _add(x: np.ndarray, W: np.ndarray, y: np.ndarray) -> None:
    add_product(x, W, y)


@pytest.mark.parametrize("shape", [(6, 128), (128, 64), (256, 128), (70, 230), (200, 16), (64, 0), (3, 65)])
def test_a_product_by_rows_is_the_product(shape: tuple[int, int]) -> None:
    """Whatever the columns left over, the rows skipped, and what was there before."""
    n, m = shape
    rng = np.random.default_rng(n + m)
    x, W, before = (rng.normal(0.0, 1.0, s).astype(np.float32) for s in (n, (n, m), m))
    for zeros in (x < 0.0, np.zeros(n, bool), np.ones(n, bool)):
        sparse, around = np.where(zeros, np.float32(0.0), x), np.pad(before, 16, constant_values=7.0)
        y = around[16 : 16 + m]
        unseen = zeros & (np.arange(n) < n // 64 * 64)  # a row that meets a zero is not looked at
        W_unseen = np.where(unseen[:, None], np.float32(np.nan), W)
        _add(sparse, W_unseen, y)
        wanted = before + sparse[~zeros].astype(np.float64) @ W[~zeros]
        np.testing.assert_allclose(y, wanted, atol=1e-5 * np.sqrt(n + 1.0))
        assert (np.delete(around, np.arange(16, 16 + m)) == 7.0).all()  # nothing is written beside it


def test_a_product_of_what_does_not_fit_is_refused() -> None:
    x, W, y = np.ones(6, np.float32), np.ones((6, 128), np.float32), np.ones(128, np.float32)
    for short in ((x[:5], W, y), (x, W, y[:64])):
        with pytest.raises(ValueError, match="shapes"):
            _add(*short)
    for other in ((x, np.asfortranarray(W), y), (x, W.astype(np.float64), y), (np.ones(12, np.float32)[::2], W, y)):
        with pytest.raises(numba.core.errors.TypingError, match="contiguous"):
            _add(*other)


def test_what_is_no_number_stays_none() -> None:
    x, y = np.zeros(128, np.float32), np.zeros(192, np.float32)
    x[70] = np.nan
    _add(x, np.ones((128, 192), np.float32), y)
    assert np.isnan(y).all()

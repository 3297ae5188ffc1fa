"""One contract for all models of the table, and what each must do by itself."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.errors import InputRefused, LibraryMissing, UsageError
from bcid.estimate.command_parts import hold_for_periods
from bcid.estimate.tuning import Noise, Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import predict_whole_take
from bcid.models import published
from bcid.models.fitting.genetic import minimise_genetically
from bcid.models.fitting.windows import inverse_spread, single_steps
from bcid.models.interface import (
    FitTask,
    History,
    Model,
    RolloutDiverged,
    history_at,
    history_at_rest,
    rollout,
)
from bcid.models.kinematic import library
from bcid.models.kinematic.state import KinematicCar
from bcid.models.newton_euler import linear
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.saving import load_model, save_model
from bcid.models.table import FITTABLE, MODELS, fittable_row, model_row, require_training_libraries
from bcid.physics import car as equations
from bcid.physics.car import Car
from bcid.vehicle import Vehicle

QUICK: dict[str, dict[str, Any]] = {
    "newton-euler": {"starts": 3},
    **dict.fromkeys(
        ("narx-mlp", "k-mlp", "k-sindy-mlp"),
        {"epochs": 60, "learning_rate": 2e-3, "decay_epochs": 15, "hidden": [48, 32]},
    ),
}


def fitted(name: str, estimates: list[Estimate], vehicle: Vehicle, seed: int = 1, **more: Any) -> Model:
    row = model_row(name)
    base = fitted(row.base, estimates, vehicle, seed) if row.base else None
    settings = {**row.defaults, **QUICK.get(name, {}), **more}
    return row.load_class().fit(FitTask(estimates, vehicle, settings, seed, base))


@pytest.fixture(scope="session")
def models(estimates: list[Estimate], vehicle: Vehicle) -> dict[str, Model]:
    return {name: fitted(name, estimates, vehicle) for name in FITTABLE if can_be_trained(name)}


def theta(x: np.ndarray, terms: np.ndarray, frame: KinematicCar) -> np.ndarray:
    return np.asarray(library.theta_matrix(x[None], terms, frame)[0])


def can_be_trained(name: str) -> bool:
    """Whether the libraries that train a model, and the one that it builds on, are installed."""
    row = model_row(name)
    try:
        require_training_libraries([name, *([row.base] if row.base else [])])
    except LibraryMissing:
        return False
    return True


def needs(*names: str) -> pytest.MarkDecorator:
    """Skips a test where one of the models `names` cannot be trained."""
    return pytest.mark.skipif(not all(map(can_be_trained, names)), reason="a library that trains them is not installed")


every_model = pytest.mark.parametrize("name", [pytest.param(name, marks=needs(name)) for name in FITTABLE])


@every_model
def test_closed_loop_follows_the_take(name: str, models: dict[str, Model], estimates: list[Estimate]) -> None:
    """Even small fits follow the motion far better than its mean does (NMSE 1); the linear one need not."""
    take = estimates[0]
    weights = inverse_spread(take.twist)
    error = (((predict_whole_take(models[name], take) - take.twist) * weights) ** 2).mean()
    assert np.isfinite(error)
    assert error < (20.0 if name == "newton-euler-linear" else 0.15)


@every_model
def test_moving_the_start_moves_the_whole_rollout(
    name: str, models: dict[str, Model], estimates: list[Estimate]
) -> None:
    """Rollouts know nothing of where the car is, nor when: the same history elsewhere is the same rollout."""
    model, take = models[name], estimates[0]
    here = rollout(model, history_at(take, 100, model.lags), take.command[100:150])
    rows = np.arange(100 - model.lags, 101)
    elsewhere, later = take.pose[rows] + [3.0, -2.0, 1.0], take.time_s[rows] + 50.0
    history = History(take.twist[rows], take.kinematic[rows], take.parts[rows[:-1]], elsewhere, later)
    there = rollout(model, history, take.command[100:150])
    np.testing.assert_array_equal(here, there)


@every_model
def test_the_past_never_sees_the_future(name: str, models: dict[str, Model], estimates: list[Estimate]) -> None:
    model, take = models[name], estimates[0]
    changed = take.command[:200].copy()
    changed[120:] = [-0.5, 0.3]
    one, other = (rollout(model, history_at(take, 0, model.lags), c) for c in (take.command[:200], changed))
    np.testing.assert_array_equal(one[:121], other[:121])
    assert not np.allclose(one[121:], other[121:])


@every_model
def test_steps_are_the_rollout(name: str, models: dict[str, Model], estimates: list[Estimate]) -> None:
    model, take = models[name], estimates[0]
    history = history_at(take, 50, model.lags)
    carry, twists = model.init(history), [history.twist[-1]]
    for command in take.command[50:80]:
        carry, twist = model.step(carry, command)
        twists.append(twist)
    np.testing.assert_allclose(rollout(model, history, take.command[50:80]), twists, atol=1e-12)


@every_model
def test_saving_and_loading_gives_the_identical_rollout(
    name: str, models: dict[str, Model], estimates: list[Estimate], tmp_path: Path
) -> None:
    model, take = models[name], estimates[0]
    save_model(model, tmp_path)
    again = load_model(tmp_path)
    history = history_at(take, 10, model.lags)
    one, other = (rollout(m, history, take.command[10:200]) for m in (model, again))
    np.testing.assert_array_equal(one, other)
    assert again.describe() == model.describe()
    assert again.parameter_count == model.parameter_count > 0


@every_model
def test_the_same_seed_gives_the_same_model(
    name: str, models: dict[str, Model], estimates: list[Estimate], vehicle: Vehicle
) -> None:
    again = fitted(name, estimates, vehicle)
    data, arrays = models[name].to_saved()
    data_again, arrays_again = again.to_saved()
    assert json.dumps(data) == json.dumps(data_again)
    for key, values in arrays.items():
        np.testing.assert_array_equal(values, arrays_again[key])


@every_model
def test_the_description_prints_equations(name: str, models: dict[str, Model]) -> None:
    text = models[name].describe()
    assert "=" in text
    assert len(text.splitlines()) >= 2


@every_model
def test_a_model_is_immutable(name: str, models: dict[str, Model]) -> None:
    with pytest.raises(AttributeError):
        models[name].facts = {}  # type: ignore[attr-defined]


def plain_network(w: Any, x: np.ndarray) -> np.ndarray:
    hidden = np.maximum((x - w.x_mean) / w.x_sd @ w.W1 + w.b1, 0.0)
    return w.y_mean + w.y_sd * (np.maximum(hidden @ w.W2 + w.b2, 0.0) @ w.W3 + w.b3)


def plain_sum(sparse: Any, x: np.ndarray, frame: Any) -> np.ndarray:
    v, alpha_f, alpha_r, delta, u_s, u_m = x
    rate = np.clip((u_s - delta) / frame.T_s, -frame.d, frame.d)
    q = np.array(
        [v, alpha_f, alpha_r, delta, rate, abs(alpha_f), abs(delta), abs(rate), max(0.0, u_m - v), min(0.0, u_m)]
    )
    columns = ((sparse.xi_v, sparse.speed), (sparse.xi_f, sparse.slip), (sparse.xi_r, sparse.slip))
    return np.array([xi @ np.prod(q**terms, axis=1) for xi, terms in columns])


@needs("k-sindy", "k-mlp", "k-sindy-mlp", "narx-mlp")
def test_compiled_steps_are_the_plain_ones(models: dict[str, Any], estimates: list[Estimate]) -> None:
    """Sums to 1e-9; networks, which run in single precision, to 1e-5."""
    take = estimates[0]
    sindy, k, res, narx = (models[n] for n in ("k-sindy", "k-mlp", "k-sindy-mlp", "narx-mlp"))
    for row in (40, 200, 333):
        state, command = take.kinematic[row], take.command[row]
        x = np.concatenate([state, command])
        after = plain_sum(sindy.sparse, x, sindy.car)
        np.testing.assert_allclose(sindy.step(state, command)[0][:3], [max(after[0], 0.0), *after[1:]], atol=1e-9)
        np.testing.assert_allclose(k.step(state, command)[0][:3], plain_network(k.weights, x), atol=1e-5)
        both = plain_sum(res.sindy.sparse, x, res.sindy.car) + plain_network(res.weights, x)
        np.testing.assert_allclose(res.step(state, command)[0][:3], both, atol=1e-5)
        rows = [row, row - 1, row - 2]
        past = np.concatenate([take.twist[rows].ravel(), take.command[rows].ravel()])
        carry = narx.init(history_at(take, row, 2))
        np.testing.assert_allclose(narx.step(carry, command)[1], plain_network(narx.weights, past), atol=1e-5)


# --- Newton-Euler ------------------------------------------------------------------------------------------------


def clean_estimates(model: Model, count: int = 2, rows: int = 1200) -> list[Estimate]:
    """Noise-free estimates of a take that `model` itself drives."""
    out = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        command = np.repeat(
            np.column_stack([rng.uniform(-1.9, 1.9, rows // 15), rng.choice([2.033, 2.033, 1.2, -0.4], rows // 15)]),
            15,
            axis=0,
        )
        carry = np.zeros(4)
        twist, angle = [np.zeros(3)], [0.0]
        for u in command[:-1]:
            carry, v = model.step(carry, u)
            twist.append(v)
            angle.append(float(carry[3]))
        twists, delta = np.array(twist), np.array(angle)
        v_fy = twists[:, 1] + 0.54 * twists[:, 2]
        kinematic = np.column_stack(
            [np.hypot(twists[:, 0], v_fy), np.arctan2(v_fy, twists[:, 0]) - delta, np.zeros(rows), delta]
        )
        zero = np.zeros((rows, 3))
        out.append(
            Estimate(
                f"made {seed}", 0.1, 0.1 * np.arange(rows), np.ones(rows, dtype=np.int64), zero, twists, kinematic,
                hold_for_periods(command, 0.1), zero, np.zeros((rows, 4)), Tuning(noise=Noise(), T_s=0.155, d=1.418),
            )
        )  # fmt: skip
    return out


def car_of(**changes: float) -> Car:
    return published.newton_euler().car._replace(R_1=30.0, R_2=5.0, **changes)


@pytest.mark.parametrize("loss", ["one-step", "rollout"])
@pytest.mark.parametrize("optimiser", [pytest.param("genetic", marks=pytest.mark.slow), "levenberg-marquardt"])
def test_newton_euler_finds_its_own_constants(optimiser: str, loss: str, vehicle: Vehicle) -> None:
    """Least squares to the last digits, the genetic algorithm nearly."""
    truth, takes = NewtonEuler(car_of(), 0.1, {}), clean_estimates(NewtonEuler(car_of(), 0.1, {}))
    model = fitted(
        "newton-euler", takes, vehicle, population=150, generations=90, optimiser=optimiser, loss=loss, subset=0.5
    )
    car = model.car  # type: ignore[attr-defined]
    exact = optimiser == "levenberg-marquardt"
    assert model.facts["nmse"] < (1e-12 if exact else 3e-4)  # type: ignore[attr-defined]
    assert exact or "F_r_max   * not identified" in model.describe()  # the rear tyres hardly ever saturate
    for symbol in ("F_m_max", "K_t", "K_b", "I_z", "C_f", "C_r", "F_f_max"):
        assert getattr(car, symbol) == pytest.approx(getattr(truth.car, symbol), rel=1e-4 if exact else 0.1), symbol


def test_fitted_drag_dissipates_at_every_speed_driven(models: dict[str, Any]) -> None:
    """Errata 6: the Table's R_2 would drive above 2.78 m/s."""
    car, top = models["newton-euler"].car, models["newton-euler"].facts["top_speed_mps"]
    speeds = np.linspace(0.0, top, 50)
    assert (speeds * (car.R_1 * speeds + car.R_2 * speeds * np.abs(speeds)) >= 0.0).all()
    table = published.newton_euler().car
    assert 3.0 * (table.R_1 + table.R_2 * 3.0) < 0.0


@pytest.mark.parametrize(("share", "drive"), [(1.0, "front"), (0.0, "rear"), (0.5, "all")])
def test_straight_driving_does_not_care_which_axle_drives(share: float, drive: str) -> None:
    car = car_of()._replace(front_share=share)
    F_x, F_y, M_z = equations.wrench(1.0, 0.0, 0.0, 0.0, 1.8, car)
    assert F_x == pytest.approx(car.K_t * 0.8 - 30.0 - 5.0)
    assert (F_y, M_z) == (0.0, 0.0)


def test_rear_drive_pushes_along_the_body() -> None:
    """The two drives differ by where F_m - F_d acts, and at which wheel's speed."""
    v_x, delta = 1.0, 0.5
    front, rear = (equations.wrench(v_x, 0.0, 0.0, delta, 1.8, car_of()._replace(front_share=s)) for s in (1.0, 0.0))

    def force(v_w: float) -> float:
        return 274.8 * (1.8 - v_w) - 30.0 * v_w - 5.0 * v_w * v_w

    at_front = force(v_x * np.cos(delta))
    assert rear[0] - front[0] == pytest.approx(force(v_x) - np.cos(delta) * at_front)
    assert rear[1] - front[1] == pytest.approx(-np.sin(delta) * at_front)
    assert rear[2] - front[2] == pytest.approx(-0.54 * np.sin(delta) * at_front)


def test_force_law_uses_its_dead_zone() -> None:
    car = car_of()._replace(sets_force=1.0, K_t=25.0, u_0=0.16, K_v=5.0, F_m_max=1e5)
    assert equations.motor_force(0.1, 1.0, car) == 0.0
    assert equations.motor_force(0.36, 0.5, car) == pytest.approx(2.5)


def test_newton_euler_is_mirror_symmetric(models: dict[str, Any]) -> None:
    car = models["newton-euler"].car
    left = equations.advance_period((1.0, 0.2, 0.5, 0.4), 0.8, 1.5, car, 0.1)
    right = equations.advance_period((1.0, -0.2, -0.5, -0.4), -0.8, 1.5, car, 0.1)
    assert left == pytest.approx((right[0], -right[1], -right[2], -right[3]), abs=1e-14)


@pytest.mark.parametrize("v", [0.7, 1.4])
def test_the_linear_model_is_the_jacobian(v: float) -> None:
    """About straight driving in balance, below and above v_0; the drag enters by its secant."""
    car = car_of(F_m_max=1e9)
    lin = linear.linearise(car, v)
    u_m = v + (30.0 * v + 5.0 * v * v) / car.K_t  # the motor balances the drag

    def rate(x: np.ndarray, delta: float) -> np.ndarray:
        return np.array(equations.state_rate(x[0], x[1], x[2], delta, delta, u_m, car)[:3])

    x, step = np.array([v, 0.0, 0.0]), 1e-6
    np.testing.assert_allclose(rate(x, 0.0), 0.0, atol=1e-12)
    A = np.column_stack([(rate(x + step * e, 0.0) - rate(x - step * e, 0.0)) / (2 * step) for e in np.eye(3)])
    b = (rate(x, step) - rate(x, -step)) / (2 * step)
    np.testing.assert_allclose(lin.A, A[1:, 1:], rtol=1e-6)
    np.testing.assert_allclose(lin.b, b[1:], rtol=1e-6)
    assert -(lin.follow + lin.drag) == pytest.approx(A[0, 0] + 5.0 * v / car.m, rel=1e-6)
    assert lin.throttle * u_m - (lin.follow + lin.drag) * v == pytest.approx(0.0, abs=1e-12)


def test_the_linear_model_brakes_to_rest_and_stays() -> None:
    model = linear.NewtonEulerLinear(car_of(), 0.4, 0.1)
    start = replace(history_at_rest(0), twist=np.array([[1.5, 0.0, 0.0]]))
    v_x = rollout(model, start, np.tile([0.0, -0.5], (200, 1)))[:, 0]
    assert (np.diff(v_x) <= 0.0).all()
    assert 0.0 <= v_x[-1] < 1e-3
    assert np.isfinite(rollout(model, start, np.tile([1.0, 2.0], (400, 1)))).all()


# --- the genetic algorithm, the library, the samples -------------------------------------------------------------


def test_the_genetic_algorithm_leaves_the_global_random_state_alone() -> None:
    import random

    random.seed(5)
    before = random.getstate()
    best = minimise_genetically(lambda x: ((x - 0.3) ** 2).sum(axis=1), 4, 40, 60, 1, lambda share, text: None)
    assert random.getstate() == before
    assert best.x == pytest.approx(np.full(4, 0.3), abs=0.02)
    assert best.history == sorted(best.history, reverse=True)


def test_every_speed_term_but_the_throttle_vanishes_with_the_speed() -> None:
    """Errata 9: with v_f = 0 only q_v,1 may be left; the published library keeps alpha_f^2 as well."""
    frame = published.k_sindy().car
    x = np.array([0.0, 0.3, 0.1, 0.7, -0.4, 1.5])
    names = [
        library.term_name(e)
        for e, q in zip(library.SPEED_TERMS, theta(x, library.SPEED_TERMS, frame), strict=True)
        if q
    ]
    assert names == ["max(0,u_m−v)"]
    kept = theta(x, library.SPEED_TERMS_PUBLISHED, frame)
    names = [library.term_name(e) for e, q in zip(library.SPEED_TERMS_PUBLISHED, kept, strict=True) if q]
    assert names == ["max(0,u_m−v)", "α_f²"]


def test_slip_terms_are_odd_and_speed_terms_even() -> None:
    """Left and right are alike: mirrored, the slip terms change sign and the speed terms do not."""
    frame = published.k_sindy().car
    x, mirrored = np.array([0.8, 0.3, 0.1, 0.7, -0.4, 1.5]), np.array([0.8, -0.3, -0.1, -0.7, 0.4, 1.5])
    np.testing.assert_allclose(
        theta(x, library.SLIP_TERMS, frame),
        -theta(mirrored, library.SLIP_TERMS, frame),
    )
    np.testing.assert_allclose(
        theta(x, library.SPEED_TERMS, frame),
        theta(mirrored, library.SPEED_TERMS, frame),
    )


def test_the_published_equations_print_as_published() -> None:
    text = published.k_sindy().describe()
    assert "0.968 v + 0.0379 v² − 0.0155 v³ − 0.475 α_f²" in text
    assert "α_f(k+1) = 0.777 α_f + 0.00718 v δ |δ| − 0.0117 v² δ + 0.0259 v δ̇" in text
    assert "α_r(k+1) = −0.0485 α_f + 0.0147 v δ" in text.replace("− 0.0485", "−0.0485")


def test_no_sample_straddles_segments_or_recordings(estimates: list[Estimate]) -> None:
    one, other = estimates
    cut = np.ones(len(one), dtype=np.int64)
    cut[300:] = 2
    for lags in (0, 2):
        parts = single_steps([replace(one, segment=cut), other], lags)
        assert len(parts.twist) == len(one) + len(other) - 3 * (lags + 1)
        np.testing.assert_array_equal(parts.next_twist[298 - lags], one.twist[299])
        np.testing.assert_array_equal(parts.twist[299 - lags, -1], one.twist[300])
        np.testing.assert_array_equal(parts.twist[299 - lags, 0], one.twist[300 + lags])


def test_too_short_a_take_is_refused(estimates: list[Estimate]) -> None:
    tiny = replace(estimates[0], segment=np.arange(len(estimates[0])))
    with pytest.raises(InputRefused, match="uninterrupted"):
        single_steps([tiny])


def test_history_before_a_segment_is_its_first_row(estimates: list[Estimate]) -> None:
    history = history_at(estimates[0], 1, 2)
    np.testing.assert_array_equal(history.twist, estimates[0].twist[[0, 0, 1]])
    assert len(history.command) == 2
    np.testing.assert_array_equal(history.pose, estimates[0].pose[[0, 0, 1]])
    np.testing.assert_allclose(history.time_s, [0.0, 0.0, 0.1], atol=1e-9)


def test_a_divergence_is_reported_with_its_step() -> None:
    car = car_of(C_f=1e7, C_r=1e7, F_f_max=1e12, F_r_max=1e12)
    with pytest.raises(RolloutDiverged) as caught:
        rollout(
            NewtonEuler(car, 0.1, {}),
            replace(history_at_rest(0), twist=np.ones((1, 3))),
            np.tile([0.5, 2.0], (2000, 1)),
        )
    assert caught.value.step > 0


def test_an_unknown_model_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match="k-sindy-mlp"):
        model_row("pacejka")


def test_a_model_made_otherwise_is_not_fitted() -> None:
    made_by_a_diagnosis = set(MODELS) - set(FITTABLE)
    assert made_by_a_diagnosis == {"newton-euler-augmented", "newton-euler-remainder"}
    for name in made_by_a_diagnosis:
        with pytest.raises(UsageError, match="bcid diagnose"):
            fittable_row(name)


def test_a_folder_without_a_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="no fitted model"):
        load_model(tmp_path)
    (tmp_path / "model.json").write_text('{"schema": "bcid.model/9", "model": "k-mlp"}')
    with pytest.raises(InputRefused, match=r"bcid\.model/9"):
        load_model(tmp_path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1]", "no JSON object"), ('{"schema": "bcid.model/1", "model": []}', r"bcid\.model/1"),
        ("[" * 100_000, "nested too deeply"), ('{"a": ', "damaged"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(InputRefused, match=says):
        load_model(tmp_path)


def test_a_model_with_parts_missing_is_refused(tmp_path: Path) -> None:
    save_model(published.newton_euler(), tmp_path)
    whole = (tmp_path / "model.json").read_text()
    (tmp_path / "model.json").write_text(whole.replace('"I_z"', '"J_z"'))
    with pytest.raises(InputRefused, match="digest differs"):
        load_model(tmp_path)
    (tmp_path / "model.json").write_text(whole.replace('"I_z"', '"J_z"').replace('"sha256"', '"was"'))
    with pytest.raises(InputRefused, match="J_z"):
        load_model(tmp_path)
    (tmp_path / "model.json").write_text(whole)
    (tmp_path / "arrays.safetensors").write_bytes(b"not arrays")
    with pytest.raises(InputRefused, match="newton-euler"):
        load_model(tmp_path)

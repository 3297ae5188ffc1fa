"""Predictions with covariance: closed forms, drawn errors beside linearised ones, starts, tables, refusals."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from exported_models import MODELS, PERIOD_S

from bcid.aliases import Floats
from bcid.diagnosis.judge.fitted_models import model_from_fit
from bcid.errors import InputRefused, UsageError
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import integrate_poses
from bcid.evaluation.limits import LIMITS
from bcid.evaluation.noise_covariance import NORMAL_FACTOR, calibrate_pose_factor, noise_covariance, predict_motion
from bcid.evaluation.process_noise import ProcessNoise, sample_rollouts
from bcid.evaluation.validity import DataRange, ModelValidity
from bcid.files.json import read_json, write_json
from bcid.files.parquet import read_columns
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.refit import Fit
from bcid.likelihood.refit_state import Tangent
from bcid.likelihood.scales import Scales
from bcid.models.interface import History, Model, history_at
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import constant_facts
from bcid.models.saving import load_model, save_model
from bcid.prediction.commands import read_command_parts
from bcid.prediction.constants import correlation_matrix, vary_constants
from bcid.prediction.covariance import constants_covariance
from bcid.prediction.fitted_model import BeyondData, FittedModel, load_fitted_model
from bcid.prediction.start import Moment, State, start_from_state
from bcid.prediction.table import COLUMNS

WIDE = DataRange((-50.0,) * 6, (50.0,) * 6)
NARROW = DataRange((-0.1, -0.5, -0.5, -0.5, -0.3, -0.1), (1.0, 0.5, 0.5, 0.5, 0.3, 1.0))


@dataclass(frozen=True)
class Gliding:
    """A body that keeps its twist: all covariances are known in closed form."""

    period_s: float = 0.1
    name: str = "gliding"
    lags: int = 0
    motion: ClassVar[slice] = slice(0, 3)

    def init(self, history: History) -> Floats:
        return history.twist[-1].copy()

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        return carry, np.tile(carry, (len(commands), 1))

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        return carries, np.repeat(carries[:, None], commands.shape[1], axis=1)


def white(factor: float = NORMAL_FACTOR, pose_factor: float = NORMAL_FACTOR) -> ProcessNoise:
    """White pushes along the body."""
    return ProcessNoise((0.2, 0.0, 0.0), 0.0, factor, pose_factor)


def gliding(noise: ProcessNoise | None = None) -> FittedModel:
    model: Any = Gliding()
    return FittedModel(model, ModelValidity(noise, WIDE), Path("gliding"), "")


def test_errors_of_the_start_grow_as_they_do_on_a_straight_line() -> None:
    sd = {"x": 0.01, "y": 0.02, "yaw": 0.003, "v_x": 0.05, "v_y": 0.04, "yaw_rate": 1e-4}
    found = gliding().predict(np.zeros((50, 2)), State(v_x=1.5, sd=sd))
    t = found.time_s
    np.testing.assert_allclose(found.pose[:, 0], 1.5 * t, atol=1e-12)
    x = 0.01**2 + (0.05 * t) ** 2
    y = 0.02**2 + (0.04 * t) ** 2 + (1.5 * 0.003 * t) ** 2 + (1.5 * 1e-4 * t**2 / 2.0) ** 2
    np.testing.assert_allclose(found.sd[:, 0], np.sqrt(x), rtol=1e-4)
    np.testing.assert_allclose(found.sd[:, 1], np.sqrt(y), rtol=1e-4)
    np.testing.assert_allclose(found.covariance[:, 0, 3], 0.05**2 * t, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.covariance[:, 1, 2], 1.5 * (0.003**2 * t + 1e-8 * t**3 / 2.0), rtol=1e-4)


def test_white_pushes_make_the_speed_a_random_walk() -> None:
    found = gliding(white()).predict(np.zeros((100, 2)), State(v_x=1.0))
    t, q2 = found.time_s, 0.2**2
    np.testing.assert_allclose(found.covariance[:, 3, 3], q2 * t, rtol=1e-9, atol=1e-15)
    # of an integral of a random walk: q^2 t^3 / 3, as far as steps of 0.1 s make one
    assert found.covariance[-1, 0, 0] == pytest.approx(q2 * 10.0**3 / 3.0, rel=0.02)
    assert found.covariance[-1, 0, 3] == pytest.approx(q2 * 10.0**2 / 2.0, rel=0.02)
    low, high = found.interval
    np.testing.assert_allclose(high[-1, 3] - low[-1, 3], 2 * NORMAL_FACTOR * math.sqrt(q2 * 10.0))


def test_calibrated_tails_widen_pose_and_twist_each_by_its_own() -> None:
    """The 95 % intervals are as many standard deviations of the process noise wide as the calibration says."""
    plain, tailed = (gliding(n).predict(np.zeros((50, 2)), State(v_x=1.0)) for n in (white(), white(2.5, 4.0)))
    np.testing.assert_allclose(tailed.half_width[:, :3], 4.0 * plain.sd[:, :3])
    np.testing.assert_allclose(tailed.half_width[:, 3:], 2.5 * plain.sd[:, 3:])
    unknown = gliding(replace_pose_factor(None)).predict(np.zeros((50, 2)), State(v_x=1.0))
    assert "how far its poses go astray is not calibrated" in unknown.caveats


def replace_pose_factor(factor: float | None) -> ProcessNoise:
    return white()._replace(pose_factor=factor)


@pytest.mark.parametrize("bias", [0.0, 0.005])
def test_the_factor_of_the_pose_is_that_of_its_errors(bias: float) -> None:
    """A body whose speed walks at random is predicted as the normal law says; one that is pulled aside, worse."""
    rng, n, h = np.random.default_rng(7), 24000, 0.1
    v_x = 1.0 + np.cumsum(0.05 * math.sqrt(h) * rng.standard_normal(n))
    twist = np.column_stack([v_x, np.full(n, bias), np.zeros(n)])
    pose = integrate_poses(np.zeros(3), twist, h)
    seen = np.column_stack([v_x, np.zeros(n), np.zeros(n)])
    walked = Estimate(
        "walk", h, h * np.arange(n), np.zeros(n, dtype=np.int64), pose, seen,
        np.column_stack([np.abs(v_x) + 1.0, np.zeros((n, 3))]), np.tile([h, 0.0, 0.0, 0.0], (n, 1, 1)),
        np.zeros((n, 3)), np.zeros((n, 4)),
    )  # fmt: skip
    model: Any = Gliding()
    noise = ProcessNoise((0.05, 0.005, 1e-3), 0.0, NORMAL_FACTOR)
    found = calibrate_pose_factor(model, [walked], noise)
    assert found is not None
    assert found < 2.6 if bias == 0.0 else found > 2.6


def test_correlated_pushes_have_the_variance_of_their_process() -> None:
    """The variance of a sum of AR(1) pushes, by its own double sum."""
    tau, n, h = 0.7, 40, 0.1
    found = gliding(white()._replace(tau_s=tau)).predict(np.zeros((n, 2)), State(v_x=1.0))
    a = math.exp(-h / tau)
    sigma2 = 0.2**2 * (1.0 - a) / ((1.0 + a) * h)
    for k in (1, 7, n):
        lag = np.abs(np.subtract.outer(np.arange(k), np.arange(k)))
        assert found.covariance[k, 3, 3] == pytest.approx(h * h * sigma2 * (a**lag).sum(), rel=1e-9)


@pytest.mark.parametrize("tau", [0.0, 2.0])
def test_fewer_and_longer_pushes_make_the_same_variance(tau: float) -> None:
    noise, n = white()._replace(tau_s=tau), 3 * LIMITS.max_pushes
    found = gliding(noise).predict(np.zeros((n, 2)), State(v_x=1.0))
    fine = gliding(noise).predict(np.zeros((LIMITS.max_pushes, 2)), State(v_x=1.0))
    assert found.covariance[-1, 3, 3] == pytest.approx(0.2**2 * 0.1 * n, rel=0.08)
    row = LIMITS.max_pushes // 3 * 3
    assert found.covariance[row, 3, 3] == pytest.approx(fine.covariance[row, 3, 3], rel=0.03)


def with_errors() -> dict[str, Model]:
    """A car, and a car with effects, that state how well their constants are known."""
    car, augmented = MODELS["newton-euler"], MODELS["newton-euler-augmented"]
    assert isinstance(car, NewtonEuler)
    assert isinstance(augmented, AugmentedNewtonEuler)
    about = {"unit": "", "meaning": ""}
    fitted = {"C_f": 0.02, "C_r": 0.03, "K_t": 0.02, "R_1": 0.05, "R_v": 0.04, "F_r_max": 0.7, "I_z": None}
    facts = {
        "fitted": {symbol: {**about, "relative_se": se} for symbol, se in fitted.items()},
        "correlated": [["C_f", "C_r", 0.95]],
        "top_speed_mps": 2.0,
    }
    errors = {"C_f": 0.02 * augmented.car.C_f, "K_t": 0.02 * augmented.car.K_t} | {
        name: 0.05 * abs(value) for name, value in augmented.effects.items()
    }
    return {
        "newton-euler": replace(car, facts=facts),
        "newton-euler-augmented": replace(augmented, facts={"fitted": ["C_f", "K_t", "C_r"], "se": errors}),
    }


def drive(n: int) -> Floats:
    """Parts of a drive that steers and accelerates."""
    t = PERIOD_S * np.arange(n)
    commands = np.column_stack([0.25 * np.sin(2.0 * t), 1.2 + 0.4 * np.sin(1.3 * t)])
    parts = np.zeros((n, 1, 4))
    parts[:, 0, 0], parts[:, 0, 1:3] = PERIOD_S, commands
    return parts


def assert_covariances_agree(drawn: Floats, found: Floats, allowed: float = 0.06) -> None:
    """Covariance of drawn motions (S, T, 6) beside the linearised one (T, 6, 6): within 6 standard errors and 6 %."""
    off = drawn - drawn.mean(axis=0)
    sampled = np.einsum("sti,stj->tij", off, off) / (len(drawn) - 1)
    variance = np.diagonal(found, axis1=1, axis2=2)
    scale = np.sqrt(variance[:, :, None] * variance[:, None, :])
    error = np.sqrt((scale**2 + found**2) / len(drawn))
    assert (np.abs(sampled - found) <= 6.0 * error + allowed * scale + 1e-16).all()


ROWS, DRAWS = np.array([10, 50, 100]), 2000


@pytest.mark.parametrize("name", ["newton-euler", "newton-euler-augmented", "k-sindy", "narx-mlp"])
def test_drawn_pushes_make_the_linearised_covariance(name: str) -> None:
    model, parts = MODELS[name], drive(100)
    start = start_from_state(State(v_x=1.0, delta=0.05), model, parts[0, 0, 1:3])
    noise = ProcessNoise((0.02, 0.01, 0.02), 0.3, 2.0)
    found = noise_covariance(model, start.history, parts, noise)
    rng = np.random.default_rng(3)
    carry = model.init(start.history)
    twist = sample_rollouts(model, carry[None], parts[None], DRAWS, np.array(noise.q), noise.tau_s, rng)[0]
    first = np.tile(start.history.twist[-1], (DRAWS, 1, 1))
    twist = np.concatenate([first, twist], axis=1)
    drawn = np.concatenate([integrate_poses(np.tile(start.history.pose[-1], (DRAWS, 1)), twist, PERIOD_S), twist], 2)
    assert_covariances_agree(drawn[:, ROWS], found[ROWS])


@pytest.mark.parametrize("name", ["newton-euler", "newton-euler-augmented", "k-sindy", "narx-mlp"])
def test_drawn_starts_make_the_linearised_covariance(name: str) -> None:
    model, parts, rng = MODELS[name], drive(100), np.random.default_rng(4)
    sd = {"x": 0.01, "y": 0.01, "yaw": 0.01, "v_x": 0.02, "v_y": 0.01, "yaw_rate": 0.01, "delta": 0.005}
    state = State(v_x=1.0, v_y=0.02, yaw_rate=0.1, delta=0.05, sd=sd)
    found = FittedModel(model, None, Path(name), "").predict(parts, state)
    draws = []
    for _ in range(DRAWS):
        moved = {n: getattr(state, n) + s * rng.standard_normal() for n, s in sd.items()}
        history = start_from_state(State(**moved), model, parts[0, 0, 1:3]).history
        draws.append(predict_motion(model, history, parts))
    constants = constants_covariance(vary_constants(model), start_from_state(state, model, np.zeros(2)).history, parts)
    assert not constants.any()
    assert_covariances_agree(np.array(draws)[:, ROWS], found.covariance[ROWS])


@pytest.mark.parametrize("name", ["newton-euler", "newton-euler-augmented"])
def test_drawn_constants_make_the_linearised_covariance(name: str) -> None:
    model, parts, rng = with_errors()[name], drive(100), np.random.default_rng(5)
    varied = vary_constants(model)
    history = start_from_state(State(v_x=1.0, delta=0.05), model, parts[0, 0, 1:3]).history
    found = constants_covariance(varied, history, parts)
    factor = np.linalg.cholesky(varied.correlation + 1e-12 * np.eye(len(varied.correlation)))
    draws = []
    for _ in range(DRAWS):
        z = factor @ rng.standard_normal(len(factor))
        draws.append(
            predict_motion(
                changed(model, {v.symbol: s for v, s in zip(varied.variations, z, strict=True)}), history, parts
            )
        )
    assert_covariances_agree(np.array(draws)[:, ROWS], found[ROWS], allowed=0.1)


def fit_with_correlations() -> Fit:
    """A car with an effect, fitted: all errors of 3 %, of stiffness and grip, and of both drags, strongly dependent."""
    car = MODELS["newton-euler-augmented"]
    assert isinstance(car, AugmentedNewtonEuler)
    hypothesis = Hypothesis(("rear_rolling_viscous",), car.car, car.angle_limit, car.constants)
    phi, names = hypothesis.phi_of(car.car, [4.0]), hypothesis.parameter_names
    rho = np.eye(len(names))
    for a, b, r in (("C_f", "C_r", 0.9), ("R_1", "R_2", -0.8), ("K_t", "R_1", 0.25), ("R_1", names[-1], -0.2)):
        i, j = names.index(a), names.index(b)
        rho[i, j] = rho[j, i] = r
    assert np.linalg.eigvalsh(rho)[0] > 0.0
    sd = 0.03 * np.where(np.arange(len(names)) < len(hypothesis.log_parameters), 1.0, 2.0 * np.abs(phi))
    scales = Scales(np.ones(3), np.ones(3))
    nothing = np.zeros(0)
    return Fit(
        hypothesis, phi, nothing, scales, 0.0, nothing, rho * np.outer(sd, sd), Tangent(nothing, nothing)
    )  # fmt: skip


def test_parameters_drawn_from_a_fit_s_covariance_make_the_saved_model_s(tmp_path: Path) -> None:
    fit, parts, rng = fit_with_correlations(), drive(100), np.random.default_rng(7)
    save_model(model_from_fit(fit, 60.0, PERIOD_S), tmp_path)
    model = load_model(tmp_path)
    history = start_from_state(State(v_x=1.0, delta=0.05), model, parts[0, 0, 1:3]).history
    varied = vary_constants(model)
    assert varied.left_out == ()
    found = constants_covariance(varied, history, parts)
    drawn = [
        predict_motion(model_from_fit(replace(fit, phi=phi), 60.0, PERIOD_S), history, parts)
        for phi in rng.multivariate_normal(fit.phi, fit.covariance, DRAWS)
    ]
    assert_covariances_agree(np.array(drawn)[:, ROWS], found[ROWS], allowed=0.1)
    # an earlier version's file is read, and counts them as independent, which is far off
    data = read_json(tmp_path / "model.json")
    data.pop("sha256", None)
    del data["facts"]["correlation"]
    write_json(tmp_path / "model.json", data)
    independent = constants_covariance(vary_constants(load_model(tmp_path)), history, parts)
    assert np.abs(independent[-1] / found[-1] - 1.0).max() > 0.3


def test_a_fit_to_recordings_states_all_correlations_of_what_it_identifies() -> None:
    covariance = np.array([[4.0, 1.2, np.nan], [1.2, 1.0, np.nan], [np.nan, np.nan, np.nan]])
    about = {symbol: {"unit": "N/rad", "meaning": ""} for symbol in ("C_f", "C_r", "F_r_max")}
    facts = constant_facts(about, covariance, np.array([0.02, 0.01, np.nan]), [])
    assert facts["correlated"] == []
    car = MODELS["newton-euler"]
    assert isinstance(car, NewtonEuler)
    varied = vary_constants(replace(car, facts={**facts, "top_speed_mps": 2.0}))
    assert [v.symbol for v in varied.variations] == ["C_f", "C_r"]
    np.testing.assert_allclose(varied.correlation, [[1.0, 0.6], [0.6, 1.0]])


@pytest.mark.parametrize(
    ("matrix", "said"),
    [
        ([[1.0, 0.5]], "one row and one column"), ([[1.0, 0.5], [0.4, 1.0]], "symmetric"),
        ([[0.9, 0.5], [0.5, 1.0]], "diagonal"), ([[1.0, 1.5], [1.5, 1.0]], "less than or equal to 1"),
    ],
)  # fmt: skip
def test_what_is_no_correlation_is_refused_where_a_model_is_read(
    matrix: list[list[float]], said: str, tmp_path: Path
) -> None:
    model = with_errors()["newton-euler-augmented"]
    assert isinstance(model, AugmentedNewtonEuler)
    wrong = {"symbols": ["C_f", "K_t"], "matrix": matrix}
    save_model(replace(model, facts={**model.facts, "correlation": wrong}), tmp_path)
    with pytest.raises(InputRefused, match=said):
        load_model(tmp_path)


def changed(model: Model, errors: dict[str, float]) -> Model:
    """The model with its constants off by so many standard errors, written without the code under test."""
    if isinstance(model, AugmentedNewtonEuler):
        se = model.facts["se"]
        car = model.car._replace(
            **{s: getattr(model.car, s) + z * se[s] for s, z in errors.items() if s in ("C_f", "K_t")}
        )
        effects = {name: value + errors.get(name, 0.0) * se[name] for name, value in model.effects.items()}
        return replace(model, car=car, effects=effects)
    assert isinstance(model, NewtonEuler)
    car, facts = model.car, model.facts
    factor = {s: 1.0 + z * facts["fitted"][s]["relative_se"] for s, z in errors.items()}
    top = facts["top_speed_mps"]
    R_1, R_v = car.R_1 * factor["R_1"], (car.R_1 + car.R_2 * top) * factor["R_v"]
    plain = {s: getattr(car, s) * factor[s] for s in ("C_f", "C_r", "K_t")}
    return replace(model, car=car._replace(R_1=R_1, R_2=(R_v - R_1) / top, **plain))


def test_constants_that_no_take_shows_are_left_out_and_named() -> None:
    model = with_errors()["newton-euler"]
    assert vary_constants(model).left_out == ("F_r_max", "I_z")
    found = FittedModel(model, None, Path("m"), "").predict(drive(20), State(v_x=1.0))
    assert "the errors of F_r_max, I_z are not known" in found.caveats
    assert "no process noise is known of this model" in found.caveats
    assert "the constants" in found.sources
    assert "the start" not in found.sources


def test_a_parameter_a_hair_from_its_bound_varies_inward_as_one_at_the_bound() -> None:
    """A symmetric change would be of that hair, and its prediction the rounding of a thousand million such changes."""
    model = with_errors()["newton-euler-augmented"]
    assert isinstance(model, AugmentedNewtonEuler)
    history = start_from_state(State(v_x=1.0, delta=0.05), model, np.zeros(2)).history
    found = []
    for value in (1e-15, 1e-9, 0.01):
        name = "rear_rolling_viscous__b"
        near = replace(model, effects={**model.effects, name: value}, facts={"se": {name: 0.5}})
        varied = vary_constants(near)
        assert [v.symbol for v in varied.variations] == [name]
        found.append(constants_covariance(varied, history, drive(50))[-1])
    assert found[0][3, 3] > 0.0
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)
    np.testing.assert_allclose(found[0], found[2], rtol=0.1, atol=1e-2 * np.abs(found[0]).max())


def test_strong_correlations_alone_still_make_a_matrix_of_correlations() -> None:
    """a with b, b with c, but not a with c: no such errors exist, and the nearest that do are taken."""
    found = correlation_matrix(["a", "b", "c"], [("a", "b", 0.95), ("b", "c", 0.95)])
    assert np.linalg.eigvalsh(found).min() > -1e-12
    np.testing.assert_allclose(np.diag(found), 1.0)
    np.testing.assert_allclose(correlation_matrix(["a", "b"], [("a", "b", -0.9)]), [[1.0, -0.9], [-0.9, 1.0]])


@pytest.fixture(scope="module")
def fitted(estimates: list[Estimate]) -> FittedModel:
    """A car that suits no data, with a period of the estimates."""
    model = MODELS["newton-euler"]
    assert isinstance(model, NewtonEuler)
    noise = ProcessNoise((0.1, 0.1, 0.1), 0.0, 2.0, 2.0)
    return FittedModel(model.with_period(0.1), ModelValidity(noise, WIDE), Path("car"), "")


def test_from_a_moment_the_first_row_is_the_estimated_one(fitted: FittedModel, estimates: list[Estimate]) -> None:
    e = estimates[0]
    k = 203
    found = fitted.predict(start=Moment(e, float(e.time_s[k]) + 0.04), duration_s=2.0)
    assert len(found) == 21
    np.testing.assert_array_equal(found.pose[0], e.pose[k])
    np.testing.assert_array_equal(found.twist[0], e.twist[k])
    np.testing.assert_allclose(found.time_s, e.time_s[k : k + 21], atol=1e-9)
    np.testing.assert_allclose(found.sd[0, 3:], e.twist_sd[k])
    assert e.tuning
    np.testing.assert_allclose(found.sd[0, 2], e.tuning.noise.r_yaw)
    expected = predict_motion(fitted.model, history_at(e, k, 0), e.parts[k : k + 20])
    np.testing.assert_array_equal(np.hstack([found.pose, found.twist]), expected)
    held = fitted.predict(np.tile([0.1, 1.0], (20, 1)), Moment(e, float(e.time_s[k])))
    assert not np.allclose(held.pose[-1], found.pose[-1])


def test_moments_that_are_none_are_refused(fitted: FittedModel, estimates: list[Estimate]) -> None:
    e = estimates[0]
    with pytest.raises(InputRefused, match="choose a moment in there"):
        fitted.predict(start=Moment(e, float(e.time_s[-1]) + 1.0))
    with pytest.raises(InputRefused, match="choose a moment in there"):
        fitted.predict(start=Moment(e, math.nan))
    with pytest.raises(InputRefused, match="goes on for"):
        fitted.predict(start=Moment(e, float(e.time_s[-3])), duration_s=5.0)
    gap = replace(
        e,
        time_s=e.time_s + np.where(np.arange(len(e)) >= 100, 3.0, 0.0),
        segment=(np.arange(len(e)) >= 100).astype(np.int64),
    )
    with pytest.raises(InputRefused, match="; "):
        fitted.predict(start=Moment(gap, float(gap.time_s[99]) + 1.0))
    with pytest.raises(InputRefused, match=r"period_s = 0\.02"):
        FittedModel(MODELS["newton-euler"], None, Path("m"), "").predict(start=Moment(e, 10.0))


@pytest.mark.parametrize(
    ("commands", "duration_s", "said"),
    [
        (None, None, "needs commands"), (np.zeros((3, 3)), None, "shape"), (np.zeros((0, 2)), None, "hold none"),
        (np.full((3, 2), np.nan), None, "not finite"), (np.zeros((3, 2)), 1.0, "give more"),
        ([[0.1, 1.0], [0.2]], None, "no array"), (np.zeros((3, 2)), -1.0, "ask for up to"),
    ],
)  # fmt: skip
def test_commands_that_are_none_are_refused(fitted: FittedModel, commands: Any, duration_s: float, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        fitted.predict(commands, duration_s=duration_s)


@pytest.mark.parametrize(
    ("rows", "duration_s", "said"),
    [
        ("0.5,0,1\n1,0,1\n", None, "give the command that holds at time 0"),
        ("0,0,1\n0,0,1\n", None, "do not increase"), ("0,0,1\n", None, "lasts 0 s"),
        ("0,0,1\n9999,0,1\n", None, "lasts"),
    ],
)  # fmt: skip
def test_commands_files_that_say_nothing_of_the_start_are_refused(
    tmp_path: Path, rows: str, duration_s: float, said: str
) -> None:
    path = tmp_path / "c.csv"
    path.write_text(f"time_s,steering_rad,throttle_mps\n{rows}")
    with pytest.raises(InputRefused, match=said):
        read_command_parts(path, 0.1, duration_s)


def test_a_commands_file_is_driven_as_the_same_commands_in_an_array(fitted: FittedModel, tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    path.write_text("time_s,steering_rad,throttle_mps\n0,0.1,1.0\n0.5,-0.2,1.5\n1.0,0,1\n")
    array = np.repeat([[0.1, 1.0], [-0.2, 1.5], [0.0, 1.0]], 5, axis=0)
    from_file, from_array = fitted.predict(path), fitted.predict(array)
    np.testing.assert_allclose(from_file.pose, from_array.pose, atol=1e-12)
    assert len(fitted.predict(str(path), duration_s=0.75)) == 9


@pytest.mark.parametrize("text", ["speed=1", "v_x", "v_x=fast", "v_x=1,v_x=2", "v_x=inf"])
def test_states_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(UsageError):
        State.parse(text)
    with pytest.raises(UsageError):
        State(sd={"v_x": -1.0})
    with pytest.raises(UsageError):
        State(sd={"speed": 1.0})


def test_a_prediction_that_runs_away_is_refused(fitted: FittedModel) -> None:
    with pytest.raises(InputRefused, match="runs away"):
        fitted.predict(np.zeros((5, 2)), State(v_x=1e4))


def test_tables_hold_the_prediction(fitted: FittedModel, tmp_path: Path) -> None:
    found = fitted.predict(np.tile([0.1, 1.0], (20, 1)), State(v_x=1.0, sd={"v_x": 0.1}))
    for name in ("p.csv", "p.parquet"):
        found.write(tmp_path / name)
    parquet = read_columns(tmp_path / "p.parquet", COLUMNS)
    csv = np.genfromtxt(tmp_path / "p.csv", delimiter=",", names=True)
    assert csv.dtype.names == tuple(COLUMNS)
    np.testing.assert_array_equal(np.column_stack([csv[name] for name in COLUMNS]), parquet)
    np.testing.assert_array_equal(np.column_stack([csv["x_m"], csv["y_m"], csv["yaw_rad"]]), found.pose)
    np.testing.assert_array_equal(csv["cov_x_v_x_m_mps"], found.covariance[:, 0, 3])
    np.testing.assert_array_equal(csv["yaw_rate_high_radps"], found.interval[1][:, 5])
    with pytest.raises(UsageError, match="csv"):
        found.write(tmp_path / "p.xlsx")


def test_a_start_beyond_the_data_is_warned_of(fitted: FittedModel) -> None:
    """Also of what no command says: a wheel turned by 3 rad, where no take steered beyond 0.3 rad."""
    narrow = replace(fitted, validity=ModelValidity(None, NARROW))
    commands = np.tile([0.1, 0.5], (5, 1))
    assert not any("delta" in text for text in narrow.predict_quietly(commands, State(v_x=0.5, delta=0.3), None).exits)
    found = narrow.predict_quietly(commands, State(v_x=0.5, delta=3.0), None).exits
    assert found[0] == "delta is 3 rad at 0.0 s, the takes go up to 0.3 rad"
    with pytest.warns(BeyondData) as told:
        car = narrow.begin(State(v_x=5.0, delta=-3.0))
    assert [str(w.message).partition(": ")[2].split(" ")[0] for w in told] == ["delta", "v_x"]
    assert {w.filename for w in told} == {__file__}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        narrow.begin(State(v_x=0.5, delta=-0.2))
        # what was told once is not told again
        assert car.warned == {"v_x", "delta"}
        assert narrow.validity is not None
        car.warn_of(narrow.validity.range.start_exits(car.twist, -3.0), 2)


def test_a_table_is_not_written_over_unasked(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("kept", encoding="utf-8")
    found = gliding().predict(np.zeros((3, 2)), State(v_x=1.0))
    with pytest.raises(InputRefused, match="force=True"):
        found.write(path)
    assert path.read_text(encoding="utf-8") == "kept"
    found.write(path, force=True)
    assert path.read_text(encoding="utf-8").startswith("t_s,")
    assert list(tmp_path.iterdir()) == [path]


def test_what_leaves_the_data_is_warned_of_once_for_each_quantity(fitted: FittedModel) -> None:
    inside = fitted.predict_quietly(np.tile([0.1, 1.0], (20, 1)), State(v_x=0.5), None)
    assert inside.exits == ()
    narrow = replace(fitted, validity=ModelValidity(None, NARROW))
    with pytest.warns(BeyondData) as told:
        narrow.predict(np.tile([30.0, 0.5], (5, 1)), State(v_x=0.5))
    texts = [str(t.message) for t in told]
    assert any("u_s is 30 rad at 0.0 s, the takes go up to 0.3 rad" in text for text in texts)
    assert len({text.split(" is ")[0] for text in texts}) == len(texts)
    assert all(t.filename == __file__ for t in told)


def test_a_motion_goes_where_the_prediction_says(fitted: FittedModel) -> None:
    found = fitted.predict(np.tile([0.2, 1.0], (30, 1)), State(x=1.0, yaw=0.4, v_x=0.5))
    car = fitted.begin(State(x=1.0, yaw=0.4, v_x=0.5))
    for _ in range(30):
        car = car.step([0.2, 1.0])
    np.testing.assert_allclose(car.pose, found.pose[-1], atol=1e-12)
    np.testing.assert_allclose(car.twist, found.twist[-1], atol=1e-12)
    assert car.time_s == pytest.approx(3.0)
    narrow = replace(fitted, validity=ModelValidity(None, NARROW)).begin()
    with pytest.warns(BeyondData, match="u_s is 30 rad"):
        narrow = narrow.step([30.0, 0.5])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        narrow.step([30.0, 0.5])
    with pytest.raises(UsageError, match="two finite numbers"):
        car.step([0.2])


def test_a_model_is_saved_with_what_is_known_of_it(fitted: FittedModel, tmp_path: Path) -> None:
    again = fitted.save(tmp_path / "model")
    assert again == load_fitted_model(tmp_path / "model")
    assert again.validity == fitted.validity
    one, other = (m.predict(np.tile([0.2, 1.0], (9, 1))) for m in (fitted, again))
    np.testing.assert_array_equal(one.covariance, other.covariance)
    with pytest.raises(InputRefused, match="exists already"):
        fitted.save(tmp_path / "model")


def test_covariance_is_not_stated_where_errors_run_away() -> None:
    found = gliding(ProcessNoise((1e200, 0.0, 0.0), 0.0, 2.0)).predict(np.zeros((20, 2)), State(v_x=1.0))
    assert np.isnan(found.covariance[-1]).all()
    assert np.isfinite(found.covariance[0]).all()
    assert any("run away" in text for text in found.caveats)

"""Process noise, prediction intervals and the data's range."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.errors import InputRefused
from bcid.estimate.command_parts import hold_for_periods
from bcid.estimate.types import Estimate
from bcid.evaluation.intervals import measure_coverage, predict_with_interval
from bcid.evaluation.process_noise import ProcessNoise, calibrate_process_noise, draw_pushes, sample_rollouts
from bcid.evaluation.validity import FILE_NAME, DataRange, ModelValidity, load_validity
from bcid.files.parquet import read_columns
from bcid.models import published
from bcid.models.interface import history_at_rest
from bcid.models.saving import save_model

MODEL = published.newton_euler()
H = MODEL.period_s
Q = np.array([0.06, 0.04, 0.08])


def driven(q: np.ndarray, tau: float, seconds: float, seed: int) -> Estimate:
    """The model's own motion with known pushes, as an estimate without error."""
    rng = np.random.default_rng(seed)
    n = round(seconds / H)
    command = np.repeat(np.column_stack([rng.uniform(-1.2, 1.2, n // 10 + 1), rng.uniform(0.6, 1.8, n // 10 + 1)]),
                        10, axis=0)[:n]  # fmt: skip
    start = MODEL.init(history_at_rest(0))[None]
    twist = np.vstack([np.zeros(3), sample_rollouts(MODEL, start, command[None, :-1], 1, q, tau, rng)[0, 0]])
    delta = np.zeros(n)
    carry = MODEL.init(history_at_rest(0))
    for k in range(n - 1):
        carry, _ = MODEL.step(carry, command[k])
        delta[k + 1] = carry[3]
    kinematic = np.column_stack([np.hypot(twist[:, 0], twist[:, 1]), np.zeros(n), np.zeros(n), delta])
    return Estimate(
        "made", H, H * np.arange(n), np.ones(n, dtype=np.int64), np.zeros((n, 3)), twist, kinematic,
        hold_for_periods(command, H),
        np.zeros((n, 3)), np.zeros((n, 4)),
    )  # fmt: skip


@pytest.mark.parametrize("tau", [0.0, 0.5])
def test_pushes_add_up_to_their_spectral_density(tau: float) -> None:
    steps, count = 400, 4000
    total = sum(draw_pushes(count, steps, Q, tau, 0.1, np.random.default_rng(1)))
    t = 0.1 * steps
    expected = Q**2 * (t if tau == 0.0 else t - tau * (1.0 - np.exp(-t / tau)))
    np.testing.assert_allclose(total.var(axis=0), expected, rtol=4.0 * np.sqrt(2.0 / count))


def test_the_noise_that_acted_is_found_and_its_intervals_hold() -> None:
    take = driven(Q, 0.0, 2400.0, 2)
    noise = calibrate_process_noise(MODEL, [take], 3)
    assert noise is not None
    np.testing.assert_allclose(noise.q, Q, rtol=0.3)  # 24 starts' misses
    assert noise.tau_s == 0.0
    assert noise.factor == pytest.approx(1.96, abs=0.35)
    for told in measure_coverage(MODEL, driven(Q, 0.0, 600.0, 4), noise):
        n = 3 * told.starts
        assert binom.cdf(round(told.covered * n), n, 0.95) > 1e-4
        assert 0.85 < told.covered < 0.995 or told.starts < 100
        assert told.ci95[0] <= told.covered <= told.ci95[1]


def test_a_parked_end_does_not_make_a_model_sure() -> None:
    take, still = driven(Q, 0.0, 600.0, 3), 700
    rows = np.arange(len(take)) >= len(take) - still
    parked = replace(
        take, twist=np.where(rows[:, None], 0.0, take.twist), kinematic=np.where(rows[:, None], 0.0, take.kinematic),
        parts=np.where(rows[:, None, None], [H, 0.0, 0.0, 0.0], take.parts),
    )  # fmt: skip
    noise = calibrate_process_noise(MODEL, [driven(Q, 0.0, 600.0, 13), parked])
    assert noise is not None
    np.testing.assert_allclose(noise.q, Q, rtol=0.5)


def test_pushes_that_last_are_told_from_those_that_do_not() -> None:
    noise = calibrate_process_noise(MODEL, [driven(Q, 4.0, 2400.0, 14)])
    assert noise is not None
    assert noise.tau_s > 0.0
    assert all(told.covered > 0.85 for told in measure_coverage(MODEL, driven(Q, 4.0, 600.0, 15), noise))


def test_a_model_that_runs_away_has_no_noise() -> None:
    take = driven(Q, 0.0, 300.0, 16)
    car = MODEL.car._replace(R_1=-400.0, R_2=0.0)  # its drag drives
    assert calibrate_process_noise(replace(MODEL, car=car), [take]) is None


def test_a_rollout_that_runs_away_does_not_void_the_interval() -> None:
    """With noise of a metre a second some samples of this car do."""
    take = driven(np.zeros(3), 0.0, 20.0, 17)
    model = replace(MODEL, car=MODEL.car._replace(R_1=0.0, R_2=-20.0))  # beyond some speed what drives it wins
    noise = ProcessNoise((2.0, 0.1, 0.1), 0.0, 1.96)
    start, rng = model.init(history_at_rest(0))[None], np.random.default_rng(0)
    lost = ~np.isfinite(sample_rollouts(model, start, take.command[None], 200, np.array(noise.q), 0.0, rng)[0])
    assert 0.0 < lost[:, -1].any(axis=1).mean() < 0.3
    found = predict_with_interval(model, history_at_rest(0), take.command, noise)
    assert np.isfinite(found.twist).all()
    assert np.isfinite(found.half_width).all()


def test_half_the_noise_does_not_hold() -> None:
    take = driven(Q, 0.0, 600.0, 5)
    narrow = ProcessNoise(tuple(0.4 * Q), 0.0, 1.96)  # type: ignore[arg-type]
    assert all(told.covered < 0.75 for told in measure_coverage(MODEL, take, narrow))


def test_a_model_that_misses_nothing_needs_no_noise() -> None:
    noise = calibrate_process_noise(MODEL, [driven(np.zeros(3), 0.0, 300.0, 6)])
    assert noise is not None
    assert max(noise.q) < 1e-4


def test_takes_too_short_for_any_miss_give_none() -> None:
    take = driven(Q, 0.0, 20.0, 7)
    assert calibrate_process_noise(MODEL, [replace(take, segment=np.arange(len(take)))]) is None


def test_an_interval_widens_and_is_the_same_for_the_same_seed() -> None:
    take = driven(Q, 0.0, 20.0, 8)
    noise = ProcessNoise(tuple(Q), 0.0, 1.96)  # type: ignore[arg-type]
    one, same = (predict_with_interval(MODEL, history_at_rest(0), take.command, noise, seed=1) for _ in range(2))
    np.testing.assert_array_equal(one.half_width, same.half_width)
    assert (one.half_width[0] < one.half_width[20]).all()
    assert one.half_width[0, 0] == pytest.approx(1.96 * Q[0] * np.sqrt(H), rel=0.35)  # tyres hold the other two at once


def test_what_is_beyond_the_data_is_told_with_its_time() -> None:
    take = driven(np.zeros(3), 0.0, 60.0, 9)
    known = DataRange.from_estimates([take])
    assert known.first_exits(take.twist, take.command) == []
    assert known.share_outside(take.twist, take.command) == 0.0
    fast = take.twist.copy()
    fast[300:, 0] = 5.0
    first = known.first_exits(fast, take.command)[0]
    assert (first.step, first.quantity) in {(300, "v_x"), (300, "v_x yaw_rate")}
    words = {b.quantity: b.describe(H) for b in known.first_exits(fast, take.command)}
    assert words["v_x"] == f"v_x is 5 m/s at 30.0 s, the takes go up to {take.twist[:, 0].max():.3g} m/s"
    assert known.share_outside(fast, take.command) == pytest.approx(0.5, abs=0.01)


def test_limits_are_saved_beside_the_model(tmp_path: Path) -> None:
    take = driven(Q, 0.0, 60.0, 10)
    for limits in (ModelValidity(ProcessNoise((0.1, 0.2, 0.3), 1.0, 2.1), DataRange.from_estimates([take])),
                   ModelValidity(None, DataRange.from_estimates([take]))):  # fmt: skip
        limits.save(tmp_path)
        assert load_validity(tmp_path) == limits
    good = (tmp_path / FILE_NAME).read_text()
    endless = '"process_noise": {"q": [1, NaN, 2], "tau_s": 0, "factor": 2}'
    for bad in (
        "{", "[]", good.replace("limits/1", "limits/9"), json.dumps(json.loads(good) | {"range": {}}),
        good.replace('"process_noise": null', endless),
    ):  # fmt: skip
        (tmp_path / FILE_NAME).write_text(bad)
        with pytest.raises(InputRefused, match="fit the model again"):
            load_validity(tmp_path)
    (tmp_path / FILE_NAME).unlink()
    assert load_validity(tmp_path) is None


def test_a_driven_model_writes_its_prediction_and_warns_beyond_the_data(tmp_path: Path) -> None:
    take = driven(Q, 0.0, 120.0, 11)
    folder = tmp_path / "model"
    folder.mkdir()
    save_model(MODEL, folder)
    slow = replace(take, twist=0.2 * take.twist, parts=take.parts * [1.0, 1.0, 0.5, 1.0])
    ModelValidity(ProcessNoise((0.05, 0.05, 0.05), 0.0, 1.96), DataRange.from_estimates([slow])).save(folder)
    rows = [f"{0.1 * k:.2f},0.3,1.8" for k in range(100)]
    (tmp_path / "go.csv").write_text("\n".join(["time_s,steering_rad,throttle_mps", *rows, ""]))
    words = [
        "simulate",
        "ahead",
        "--out",
        str(tmp_path),
        "--model",
        str(folder),
        "--commands",
        str(tmp_path / "go.csv"),
    ]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert "beyond the data it was fitted on" in done.stderr
    assert "u_m is 1.8 at 0.0 s" in done.stderr
    names = ("v_x", "v_x_low", "v_x_high")
    v_x, low, high = read_columns(tmp_path / "ahead.prediction.parquet", dict.fromkeys(names, "m/s")).T
    assert len(v_x) == 101
    assert (low[0], high[0]) == (v_x[0], v_x[0])
    assert (low[1:] < v_x[1:]).all()
    assert (v_x[1:] < high[1:]).all()

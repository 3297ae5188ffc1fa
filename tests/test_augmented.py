"""The Newton-Euler car with effects as a model: its physics, the models' contract, the commands that take it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.effects.actuators import SteeringState, actuation_at, actuator_chain, continue_actuator_chain
from bcid.effects.car import BodyState
from bcid.effects.constants import Constants
from bcid.effects.measurement import tracked_pose
from bcid.effects.motion import integrate_body, steady_lags
from bcid.effects.table import EFFECTS
from bcid.errors import InputRefused, UsageError
from bcid.estimate.command_parts import cut_into_parts, hold_for_periods
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import integrate_poses, predict_whole_take
from bcid.models import published
from bcid.models.fitting.windows import inverse_spread
from bcid.models.interface import FitTask, History, Model, history_at, history_at_rest, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.augmented_step import advance_augmented, body_from_tracked, tracked_twist, unpack_carry
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.saving import load_model, save_model
from bcid.pipeline.config import read_pipeline_file
from bcid.pipeline.run import Pipeline
from bcid.recording.read import read_recording
from bcid.vehicle import Vehicle

CAR = published.newton_euler().car._replace(R_2=4.0)
LIMIT, T = 2.012, 60.0
CHAIN = {
    "steering_delay__tau": 0.033, "steering_lag__tau": 0.05, "steering_backlash__b": 0.02,
    "steering_dead_band__b": 0.03, "steering_rate_asymmetry__a": 0.1, "motor_delay__tau": 0.17,
    "pose_latency__tau": 0.021, "clock_drift__rho": 4e-4,
}  # fmt: skip
MEASURED = {
    "marker_offset__d_x": 0.2, "marker_offset__d_y": -0.1, "body_yaw_misalignment__psi": 0.15, "pose_scale__kappa": 0.1,
}  # fmt: skip
PATCH = {"rough_patch__b": 60.0, "rough_patch__x": 4.0, "rough_patch__y": 1.0, "rough_patch__radius": 1.0}


def augmented(facts: dict[str, Any] | None = None, **effects: float) -> AugmentedNewtonEuler:
    return AugmentedNewtonEuler(CAR, effects, Constants(), LIMIT, T, 0.1, facts or {})


def commands(rows: int = 400, seed: int = 0) -> np.ndarray:
    """Held 1.5 s each: turning both ways, full speed, slow, braking."""
    rng = np.random.default_rng(seed)
    count = rows // 15 + 1
    u = np.column_stack([rng.uniform(-1.9, 1.9, count), rng.choice([2.033, 1.2, -0.3], count)])
    u[0] = 0.3, 2.0
    return np.repeat(u, 15, axis=0)[:rows]


def standing(pose: tuple[float, float, float], time_s: float = 0.0) -> History:
    rest = history_at_rest(10)
    return replace(rest, pose=np.tile(pose, (11, 1)), time_s=np.full(11, time_s))


EVERY: dict[str, dict[str, float]] = {"none": {}, "chain": CHAIN, "measured": MEASURED, "place": PATCH}
every_model = pytest.mark.parametrize("effects", list(EVERY.values()), ids=list(EVERY))


# --- the models' contract ----------------------------------------------------------------------------------------


@every_model
def test_steps_are_the_rollout(effects: dict[str, float], estimates: list[Estimate]) -> None:
    model, take = augmented(**effects), estimates[0]
    history = history_at(take, 50, model.lags)
    carry, twists = model.init(history), [history.twist[-1]]
    for command in take.command[50:80]:
        carry, twist = model.step(carry, command)
        twists.append(twist)
    np.testing.assert_allclose(rollout(model, history, take.command[50:80]), twists, rtol=0.0, atol=1e-12)


@every_model
def test_the_past_never_sees_the_future(effects: dict[str, float], estimates: list[Estimate]) -> None:
    model, take = augmented(**effects), estimates[0]
    changed = take.command[:200].copy()
    changed[120:] = [-0.5, 0.3]
    one, other = (rollout(model, history_at(take, 0, model.lags), c) for c in (take.command[:200], changed))
    np.testing.assert_array_equal(one[:121], other[:121])
    assert not np.allclose(one[121:], other[121:])


@every_model
def test_saving_and_loading_gives_the_identical_model(effects: dict[str, float], tmp_path: Path) -> None:
    facts = {"fitted": ("K_t", "C_f"), "se": {"K_t": 2.5}}
    model = augmented(facts, **effects)
    save_model(model, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]
    again = load_model(tmp_path)
    assert again == model
    assert again.describe() == model.describe()
    assert again.parameter_count == 2 + len(effects)
    one, other = (rollout(m, history_at_rest(10), commands(100)) for m in (model, again))
    np.testing.assert_array_equal(one, other)


def test_it_follows_a_take_closed_loop(estimates: list[Estimate]) -> None:
    """The published constants are those of the simulated car, which has some extras."""
    take = estimates[0]
    error = (((predict_whole_take(augmented(), take) - take.twist) * inverse_spread(take.twist)) ** 2).mean()
    assert error < 0.05


def test_compiled_steps_are_the_plain_ones(estimates: list[Estimate]) -> None:
    model = augmented(**CHAIN, **MEASURED)
    now = unpack_carry(model.init(history_at(estimates[0], 40, 10)))
    parts = np.array([[0.03, 0.1, 1.2, 0.3], [0.07, 0.4, 1.5, 0.0], [0.0, 0.4, 1.5, 0.0]])
    plain, compiled = (f(now, parts, model.setup) for f in (advance_augmented.py_func, advance_augmented))  # type: ignore[attr-defined]
    np.testing.assert_allclose(np.array(plain.body), np.array(compiled.body), atol=1e-12)


def test_it_is_made_by_a_diagnosis_alone(vehicle: Vehicle, estimates: list[Estimate]) -> None:
    with pytest.raises(UsageError, match="bcid diagnose"):
        AugmentedNewtonEuler.fit(FitTask(estimates, vehicle, {}, 1))
    listed = CliRunner().invoke(app, ["models", "--format", "json"])
    made_by = {row["model"]: row["made_by"] for row in json.loads(listed.stdout)["models"]}
    assert made_by["newton-euler-augmented"] == "bcid diagnose"


def test_the_description_prints_every_effect_with_value_and_unit() -> None:
    every = {f: p.size for e in EFFECTS.values() for f, p in zip(e.fields, e.parameters, strict=True)}
    text = augmented({"fitted": ["K_t"], "se": {"K_t": 2.5, "yaw_scrub__c": 0.7}}, **every).describe()
    assert text.startswith("v_x' = F_x/m + w v_y")
    for effect in EFFECTS.values():
        assert f"{effect.id}: {effect.equation}" in text
    assert "K_t       * = 274.8      ± 2.5" in text
    assert f"c         * = {every['yaw_scrub__c']:<10.4g} ± 0.7      kg m^2 s^-1" in text
    assert "yaw_scrub" not in augmented(**CHAIN).describe()


# --- physics -----------------------------------------------------------------------------------------------------


def test_with_no_effect_it_is_newton_euler_up_to_the_integration_step() -> None:
    def apart(h: float) -> float:
        per = round(0.1 / h)
        u = np.repeat(commands(), per, axis=0)
        with_none, base = augmented().with_period(h), NewtonEuler(CAR, h, {})
        return float(np.abs(rollout(with_none, history_at_rest(10), u) - rollout(base, history_at_rest(0), u)).max())

    assert apart(0.1) < 2e-3
    assert apart(0.05) < 5e-4
    assert apart(0.005) < 1e-5


@pytest.mark.parametrize("more", [{}, {"motor_lag__tau": 0.06, "tyre_relaxation__sigma": 0.05}], ids=["chain", "lags"])
def test_delays_are_exact(more: dict[str, float]) -> None:
    """Step by step it is one run of the actuator chain over the whole drive."""
    model, u = augmented(**CHAIN, **more), commands()
    e, n = model.setup.switches, 4 * len(u)
    times = (0.1 * np.arange(-1, len(u)) + CHAIN["pose_latency__tau"]) * (1.0 + CHAIN["clock_drift__rho"])
    given = np.vstack([[0.0, 0.0], u])
    chain = actuator_chain(times, given, 0.0, n, 0.025, CAR, LIMIT, e)
    rest = BodyState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    lags, c = steady_lags(rest, actuation_at(0, chain, T), CAR, e, Constants()), Constants()
    whole = integrate_body(rest, lags, 0, n, chain, T, np.zeros((1, 3)), n, CAR, e, c)[::4, 3:6]
    np.testing.assert_allclose(rollout(model, history_at_rest(10), u), whole, rtol=0.0, atol=1e-10)


def test_the_chain_goes_on_where_it_stopped() -> None:
    e, u = augmented(**CHAIN).setup.switches, commands(80)
    times = 0.1 * np.arange(80)
    first = min(max(u[0, 0], -LIMIT), LIMIT)
    whole, end = continue_actuator_chain(SteeringState(first, first, first), times, u, 0.0, 320, 0.025, CAR, LIMIT, e)
    alone = actuator_chain(times, u, 0.0, 320, 0.025, CAR, LIMIT, e)
    np.testing.assert_array_equal(whole.delta, alone.delta)
    np.testing.assert_array_equal(whole.u_m, alone.u_m)
    servo, angles = SteeringState(first, first, first), []
    for k in range(0, 320, 20):
        part, servo = continue_actuator_chain(servo, times, u, 0.025 * k, 20, 0.025, CAR, LIMIT, e)
        angles.append(part.delta[:-1])
    np.testing.assert_allclose(np.concatenate(angles), whole.delta[:-1], rtol=0.0, atol=1e-12)
    assert servo == pytest.approx(end, abs=1e-12)
    assert servo.behind == pytest.approx(whole.delta[-1])


def test_poses_that_come_early_undo_delays_and_no_more() -> None:
    u = commands(200)
    early = augmented(pose_latency__tau=-0.02, steering_delay__tau=0.05, motor_delay__tau=0.05)
    late = augmented(steering_delay__tau=0.03, motor_delay__tau=0.03)
    np.testing.assert_allclose(rollout(early, history_at_rest(10), u), rollout(late, history_at_rest(10), u), atol=1e-9)
    impossible = rollout(augmented(pose_latency__tau=-0.02), history_at_rest(10), u)
    np.testing.assert_allclose(impossible, rollout(augmented(), history_at_rest(10), u), atol=1e-12)


@pytest.mark.parametrize("names", [[n] for n in MEASURED] + [list(MEASURED)], ids="-".join)
def test_what_the_motion_capture_does_is_undone(names: list[str]) -> None:
    e = augmented(**{n: MEASURED[n] for n in names}).setup.switches
    rng = np.random.default_rng(3)
    for _ in range(20):
        b = BodyState(*rng.normal(0.0, 2.0, 6).tolist())
        pose, twist = np.array(tracked_pose(b.p_x, b.p_y, b.theta, e)), np.array(tracked_twist(b, e))
        assert np.array(body_from_tracked(pose, twist, e)) == pytest.approx(np.array(b), abs=1e-12)
        moved = []
        for dt in (-1e-5, 1e-5):
            x = b.p_x + dt * (math.cos(b.theta) * b.v_x - math.sin(b.theta) * b.v_y)
            y = b.p_y + dt * (math.sin(b.theta) * b.v_x + math.cos(b.theta) * b.v_y)
            moved.append(tracked_pose(x, y, b.theta + dt * b.omega, e))
        rate = np.diff(moved, axis=0)[0] / 2e-5
        cos_s, sin_s = math.cos(pose[2]), math.sin(pose[2])
        seen = [cos_s * rate[0] + sin_s * rate[1], cos_s * rate[1] - sin_s * rate[0], rate[2]]
        assert twist == pytest.approx(seen, abs=1e-8)


def test_a_start_on_the_way_goes_on_as_the_whole_drive() -> None:
    """The steering, the held commands, the CoG behind the tracked body and the clock are found from the history."""
    model = augmented(**MEASURED, steering_delay__tau=0.13, motor_delay__tau=0.27, floor_slope__g_x=0.3)
    u, k = commands(), 143  # commands change at rows 120 and 135: what lies before row 133 is what it holds
    carry, rows = model.init(history_at_rest(10)), []
    e = model.setup.switches
    for command in [*u[:k], None]:
        now = unpack_carry(carry)
        b = now.body
        rows.append([*tracked_pose(b.p_x, b.p_y, b.theta, e), *tracked_twist(b, e), now.servo.angle])
        if command is not None:
            carry, _ = model.step(carry, command)
    seen = np.array(rows)[-11:]
    kinematic = np.column_stack([np.zeros((11, 3)), seen[:, 6]])
    parts, time_s = hold_for_periods(u[k - 10 : k], 0.1), 0.1 * np.arange(k - 10, k + 1)
    history = History(seen[:, 3:6], kinematic, parts, seen[:, :3], time_s)
    whole = rollout(model, history_at_rest(10), u)
    np.testing.assert_allclose(rollout(model, history, u[k:]), whole[k:], rtol=0.0, atol=1e-9)


def test_at_a_segment_s_start_the_steering_stands_where_it_is(estimates: list[Estimate]) -> None:
    """The rows before only repeat the first: no second of steering has passed."""
    model, take = augmented(), estimates[0]
    turning = int(np.argmax(np.abs(take.kinematic[:, 3])))
    cut = replace(take, segment=np.r_[np.zeros(turning, int), np.ones(len(take) - turning, int)])
    assert unpack_carry(model.init(history_at(cut, turning, 10))).servo.angle == take.kinematic[turning, 3]
    after = unpack_carry(model.init(history_at(cut, turning + 3, 10)))
    assert after.servo.angle == pytest.approx(take.kinematic[turning + 3, 3], abs=0.1)
    assert after.t == pytest.approx(take.time_s[turning + 3] - take.time_s[0])


def test_a_place_acts_where_it_is() -> None:
    model, u = augmented(**PATCH), np.tile([0.0, 2.0], (60, 1))
    far, through, beside = (
        rollout(model, standing(p), u)[:, 0] for p in ((0.0, -5.0, 0.0), (0.0, 1.0, 0.0), (4.0, -8.0, math.pi / 2))
    )
    np.testing.assert_array_equal(far, rollout(augmented(), history_at_rest(10), u)[:, 0])
    slow = np.flatnonzero(through < far - 0.05)
    x = np.r_[0.0, np.cumsum(0.1 * through)]
    assert 3.0 < x[slow[0]] < 3.6
    np.testing.assert_allclose(beside[:45], far[:45], atol=1e-9)
    assert (beside[-5:] < far[-5:] - 0.05).any()


def test_a_slope_knows_the_heading_and_a_change_of_mass_the_time() -> None:
    u = np.tile([0.0, 1.0], (30, 1))
    slope = augmented(floor_slope__g_x=0.3)
    down, level, up = (rollout(slope, standing((0.0, 0.0, h)), u)[-1, 0] for h in (0.0, math.pi / 2, math.pi))
    assert down > level + 0.2 > up + 0.4
    heavier = augmented(mass_change__d=0.5, mass_change__t_s=20.0)
    before, after = (rollout(heavier, standing((0.0, 0.0, 0.0), t), u)[5, 0] for t in (10.0, 30.0))
    assert before == rollout(augmented(), history_at_rest(10), u)[5, 0]
    assert after < 0.8 * before


# --- refusals ----------------------------------------------------------------------------------------------------


def broken(folder: Path, place: str, key: str | None, value: Any) -> Path:
    """A saved model with one value changed; a whole table where no key is named."""
    save_model(augmented(**CHAIN, **MEASURED), folder)
    data = json.loads((folder / "model.json").read_text())
    del data["sha256"]  # as an edit that is meant
    if key is None:
        data[place] = value
    else:
        data[place][key] = value
    (folder / "model.json").write_text(json.dumps(data))
    return folder


@pytest.mark.parametrize(
    ("place", "key", "value", "told"),
    [
        ("effects", "steering_delays__tau", 0.1, "steering_delay__tau"),
        ("effects", "gravity", 9.81, "gravity"),
        ("effects", "steering_delay__tau", "0.1", "effects.steering_delay__tau: should be a valid number"),
        ("effects", "steering_delay__tau", True, "effects.steering_delay__tau: should be a valid number"),
        ("effects", "steering_delay__tau", math.nan, "effects.steering_delay__tau: should be a finite"),
        ("effects", "steering_delay__tau", 1e9, "no car has"),
        ("effects", "pose_scale__kappa", -1.0, "no camera has"),
        ("effects", None, [1.0], "effects: should be an object"),
        ("car", "K_t", None, "car.K_t: should be a valid number"),
        ("car", "J_z", 3.0, "car.J_z: there is no such key"),
        ("car", None, {"m": 1.0}, "missing"),
        ("constants", "v_c", "slow", "v_c"),
        ("facts", None, 3, "facts"),
        ("angle_limit", None, -1.0, "angle_limit: should be greater than 0"),
        ("period_s", None, "0.1", "period_s"),
        ("recording_s", None, 10**400, "newton-euler-augmented"),
    ],
)
def test_a_broken_file_is_refused(tmp_path: Path, place: str, key: str | None, value: Any, told: str) -> None:
    with pytest.raises(InputRefused, match=told) as caught:
        load_model(broken(tmp_path, place, key, value))
    assert "next: " in str(caught.value)


# --- report and simulate -----------------------------------------------------------------------------------------

PLAN = """
vehicle = "{vehicle}"
training = ["{training}"]
validation = "{validation}"
workspace = "workspace"
models = ["newton-euler"]
[fit.newton-euler]
population = 10
generations = 2
[report]
timing_repeats = 1
"""


def test_a_saved_model_joins_the_report(tmp_path: Path, takes: dict[str, Path], vehicle_file: Path) -> None:
    plan = tmp_path / "pipeline.toml"
    plan.write_text(PLAN.format(vehicle=vehicle_file, training=takes["mcap"], validation=takes["other"]))
    folders = [tmp_path / name for name in ("named", "more", "base")]
    for folder, model in zip(
        folders, [augmented(rear_rolling_viscous__b=8.0), augmented(), published.newton_euler()], strict=True
    ):
        folder.mkdir()
        save_model(model, folder)

    def compared(*extra: Path) -> tuple[bool, dict[str, Any]]:
        artifact = Pipeline(read_pipeline_file(plan)).report(extra)
        return artifact.reused, {m["model"]: m for m in artifact.json("report.json")["models"]}

    _, alone = compared()
    assert set(alone) == {"newton-euler"}
    fresh, rows = compared(*folders, folders[0])
    assert not fresh
    ends = ["/".join(f.parts[-2:]) for f in folders]
    names = {f"newton-euler-augmented ({ends[1]})", f"newton-euler ({ends[2]})"}
    assert set(rows) == {"newton-euler", "newton-euler-augmented"} | names
    assert rows["newton-euler"]["nmse"] == alone["newton-euler"]["nmse"]
    assert rows["newton-euler-augmented"]["nmse"] < 0.05
    assert rows["newton-euler-augmented"]["parameters"] == 1
    words = ["report", "-p", str(plan), *(w for f in folders for w in ("--model", str(f))), "--format", "json"]
    printed = json.loads(CliRunner().invoke(app, words, catch_exceptions=False).stdout)
    assert {m["model"] for m in printed["models"]} == set(rows)
    assert compared(*folders)[0]
    save_model(augmented(rear_rolling_viscous__b=9.0), folders[0])
    assert not compared(*folders)[0]
    save_model(augmented().with_period(0.05), folders[0])
    with pytest.raises(InputRefused, match="period_s"):
        compared(folders[0])
    with pytest.raises(InputRefused, match="no fitted model"):
        compared(tmp_path)


def commands_file(folder: Path, time_s: np.ndarray, command: np.ndarray) -> Path:
    path = folder / "manoeuvre.csv"
    rows = [f"{t:.3f},{s},{m}" for t, (s, m) in zip(time_s, command, strict=True)]
    path.write_text("\n".join(["time_s,steering_rad,throttle_mps", *rows]))
    return path


def simulated(tmp_path: Path, model: Model, manoeuvre: Path, *more: str) -> Path:
    folder = tmp_path / "model"
    folder.mkdir(exist_ok=True)
    save_model(model, folder)
    words = ["simulate", "drive", "--model", str(folder), "--commands", str(manoeuvre), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, [*words, *more, "--force", "--format", "json"], catch_exceptions=False)
    return Path(json.loads(done.stdout)["recordings"][0])


NOISELESS = ("--set", "position_noise=0", "--set", "yaw_noise=0")


@pytest.mark.parametrize("recorder", ["motive", "mcap"])
def test_a_saved_model_is_driven_and_recorded(tmp_path: Path, vehicle: Vehicle, recorder: str) -> None:
    """At the commands' own rate, since its equations hold for any step."""
    model = augmented(**MEASURED, steering_delay__tau=0.02)
    u = np.repeat(commands(200), 2, axis=0)[3:403]
    time_s = 0.05 * np.arange(len(u))
    path = simulated(tmp_path, model, commands_file(tmp_path, time_s, u), *NOISELESS, "--recorder", recorder)
    recording = read_recording(path, vehicle)
    np.testing.assert_allclose(recording.commands.time_s, time_s, atol=1e-6)
    np.testing.assert_allclose(recording.commands.values, u, atol=1e-6)
    fine = 0.005 * np.arange(len(u) * 10 + 1)
    twist = rollout(model.with_period(0.005), history_at_rest(10), np.repeat(u, 10, axis=0))
    pose = integrate_poses(np.zeros(3), twist, 0.005)
    assert recording.duration_s == pytest.approx(len(u) * 0.05, abs=0.02)
    for c, off in enumerate((1e-4, 1e-4, 4e-3)):  # the chassis tilts a little, which turns the heading
        at = np.interp(recording.poses.time_s, fine, pose[:, c])
        assert np.abs(recording.poses.values[:, c] - at).max() < off


def test_a_discrete_model_is_driven_in_its_own_steps(tmp_path: Path, vehicle: Vehicle) -> None:
    """Commands are written as they are, zero before the first; a discrete model is given their means."""
    times = np.r_[0.53, np.arange(0.6, 3.0, 0.05)]
    u = np.column_stack([np.full(len(times), 0.4), np.linspace(1.0, 2.0, len(times))])
    path = simulated(tmp_path, published.k_sindy(), commands_file(tmp_path, times, u), *NOISELESS, "--duration", "4")
    recording = read_recording(path, vehicle)
    assert recording.duration_s == pytest.approx(4.0, abs=0.02)
    given = recording.commands
    np.testing.assert_array_equal(given.held_at(times), np.round(u, 6))
    assert (given.values[given.time_s < 0.53] == 0.0).all()
    assert given.values[-1] == pytest.approx(u[-1], abs=1e-6)
    parts = cut_into_parts(given.time_s, given.values, 0.1 * np.arange(40), 0.1)
    moved = integrate_poses(np.zeros(3), rollout(published.k_sindy(), history_at_rest(0), parts), 0.1)
    assert recording.poses.values[-1, :2] == pytest.approx(moved[-1, :2], abs=0.01)


def test_the_seed_is_the_noise(tmp_path: Path, vehicle: Vehicle) -> None:
    manoeuvre = commands_file(tmp_path, 0.05 * np.arange(60), np.tile([0.3, 1.5], (60, 1)))
    one, same, other = (
        read_recording(simulated(tmp_path, augmented(), manoeuvre, "--seed", seed), vehicle).poses.values
        for seed in ("1", "1", "2")
    )
    np.testing.assert_array_equal(one, same)
    assert 3e-4 < (one - other)[:, 0].std() / math.sqrt(2.0) < 7e-4


def test_words_that_do_not_fit_a_saved_model_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where no pipeline file says in which workspace models are kept
    manoeuvre = commands_file(tmp_path, 0.05 * np.arange(60), np.tile([0.3, 1.5], (60, 1)))

    def refused(error: type[Exception], match: str, *words: str | Path) -> None:
        with pytest.raises(error, match=match):
            CliRunner().invoke(app, ["simulate", "drive", *map(str, words)], catch_exceptions=False)

    save_model(augmented(), tmp_path)
    model = ("--model", tmp_path, "--out", tmp_path)
    refused(UsageError, "go together", *model)
    refused(UsageError, "go together", "--commands", manoeuvre)
    refused(UsageError, "--ideal", *model, "--commands", manoeuvre, "--ideal")
    refused(UsageError, "noise", *model, "--commands", manoeuvre, "--set", "mass=300")
    refused(InputRefused, "folder of a saved model", "--model", tmp_path / "none", "--commands", manoeuvre)
    refused(InputRefused, "does not exist", *model, "--commands", tmp_path / "none.csv")
    over = manoeuvre.rename(tmp_path / "drive.commands.csv")
    refused(UsageError, "written over", *model, "--commands", over)
    again = over.rename(manoeuvre)
    again.write_text("time_s,steering_rad,throttle_mps\n0,0.1,1\n1,,1\n2,0.1,1\n")
    refused(InputRefused, "blank", *model, "--commands", again)
    again.write_text("time_s,steering_rad,throttle_mps\n0,0.1,1\n")
    refused(InputRefused, "lasts 0 s", *model, "--commands", again)
    save_model(replace(augmented(), car=CAR._replace(C_f=1e12, F_f_max=1e12)), tmp_path)
    refused(InputRefused, "diverged", *model, "--commands", again, "--duration", "30")

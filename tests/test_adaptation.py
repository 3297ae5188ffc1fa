"""A car that learns while it drives: what the filter estimates, and that it says so in C as well."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from exported_models import CAR

from bcid.adaptation.c_source import write_adapt_header, write_adapt_source
from bcid.adaptation.filter import (
    SETTLING_S,
    CompiledFilter,
    FilterNoise,
    Knowledge,
    assume_noise,
    compile_filter,
    settling_poses,
    start_filter,
)
from bcid.adaptation.filter_run import OUTLIER, keep_within, run_filter
from bcid.adaptation.formulas import LASTS_S, AdaptiveFormulas, trace_adaptive
from bcid.adaptation.quantities import (
    AdaptedQuantity,
    choose_quantities,
    release_limits,
    unreached_limits,
    with_quantities,
)
from bcid.aliases import Floats
from bcid.effects.constants import Constants
from bcid.effects.table import EFFECTS
from bcid.errors import UsageError
from bcid.export.augmented_formulas import TIMED
from bcid.export.formulas import COMMANDS
from bcid.export.reference_drive import history_of_start
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler

GCC = shutil.which("gcc")
PERIOD_S = 0.05
START_TWIST = np.array([0.5, 0.0, 0.0])
NOISE = FilterNoise(
    np.array([0.02, 0.02, 0.03]),
    np.array([1e-3, 1e-3, 2e-3]),
    np.array([0.3, 0.3, 0.5]),
    0.1,
    np.array([1.0, 1.0, 1.5]),
    0.6,
    forget_s=30.0,
)
C_NOISE = NOISE._replace(lasting_sd=(0.05, 0.05, 0.1))
PLAIN = AugmentedNewtonEuler(CAR, {}, Constants(), 2.0, 100.0, PERIOD_S, {})


class Adaptive(NamedTuple):
    model: AugmentedNewtonEuler
    quantities: tuple[AdaptedQuantity, ...]
    formulas: AdaptiveFormulas
    filter: CompiledFilter

    def run(self, commands: Floats, poses: Floats, noise: FilterNoise = NOISE) -> Any:
        z, P = start_filter(self.formulas, noise, np.zeros(3), START_TWIST, 0.0)
        return run_filter(self.filter, z, P, commands, poses)

    def column(self, name: str) -> int:
        return len(self.formulas.states) + [q.name for q in self.quantities].index(name)


def make_adaptive(*names: str, noise: FilterNoise = NOISE, model: AugmentedNewtonEuler = PLAIN) -> Adaptive:
    model, quantities = choose_quantities(model, names)
    formulas = trace_adaptive(model, quantities)
    return Adaptive(model, quantities, formulas, assume_noise(compile_filter(formulas), formulas, noise))


@pytest.fixture(scope="module")
def adaptive() -> Adaptive:
    return make_adaptive("mass", "steering_offset")


def draw_commands(seconds: float, seed: int = 0) -> Floats:
    rng, count = np.random.default_rng(seed), round(seconds)
    drawn = np.column_stack([rng.uniform(-0.8, 0.8, count), rng.uniform(0.0, 1.5, count)])
    return np.repeat(drawn, round(1.0 / PERIOD_S), axis=0)


def drive(models: list[AugmentedNewtonEuler], commands: Floats, seed: int = 0, noise: FilterNoise = NOISE) -> Floats:
    """Noisy poses of a car that is each of `models` for an equal part of the time, and is pushed as `noise` says."""
    rng = np.random.default_rng(seed)
    carry = models[0].init(history_of_start(models[0], np.zeros(3), START_TWIST, 0.0))
    poses, kept = [], math.exp(-PERIOD_S / LASTS_S)
    lasting = rng.normal(size=3) * noise.lasting_sd
    for part, model in zip(np.array_split(commands, len(models)), models, strict=True):
        for command in part:
            carry, _ = model.step(carry, command)
            carry[model.motion] += rng.normal(size=3) * noise.q * math.sqrt(PERIOD_S) + PERIOD_S * lasting
            lasting = kept * lasting + math.sqrt(1.0 - kept**2) * rng.normal(size=3) * noise.lasting_sd
            poses.append(carry[:3].copy())
    noisy: Floats = np.array(poses) + rng.normal(size=(len(poses), 3)) * noise.pose_sd
    return noisy


def test_a_passenger_is_weighed_within_ten_seconds(adaptive: Adaptive) -> None:
    mass, offset = adaptive.quantities
    cars = [with_quantities(adaptive.model, [(mass, m), (offset, 0.03)]) for m in (1.0, 1.2)]
    after = []
    for seed in range(6):
        commands = draw_commands(120.0, seed)
        run = adaptive.run(commands, drive(cars, commands, seed))
        masses = run.z[:, adaptive.column("mass")]
        assert abs(masses[round(59.0 / PERIOD_S)] - 1.0) < 0.2
        after.append(masses[round(70.0 / PERIOD_S)])
    # the standard deviation of one is 0.06
    assert np.mean(after) == pytest.approx(1.2, abs=0.06)


def test_stated_deviations_are_those_of_the_errors() -> None:
    # a filter that forgets is cautious where nothing changes
    adaptive = make_adaptive("mass", "steering_offset", noise=NOISE._replace(forget_s=1e6))
    mass, offset = adaptive.quantities
    model = with_quantities(adaptive.model, [(mass, 1.1), (offset, 0.02)])
    off = []
    for seed in range(24):
        commands = draw_commands(40.0, seed)
        run = adaptive.run(commands, drive([model], commands, seed))
        for name, true in (("mass", 1.1), ("steering_offset", 0.02)):
            column = adaptive.column(name)
            off.append((run.z[-1, column] - true) / math.sqrt(run.variance[-1, column]))
    assert 0.4 < np.mean(np.square(off)) < 1.7


def test_a_filter_that_is_not_told_poses_learns_nothing(adaptive: Adaptive) -> None:
    commands = draw_commands(10.0)
    run = adaptive.run(commands, np.full((len(commands), 3), np.nan))
    column = adaptive.column("mass")
    assert run.log_likelihood == 0.0
    assert (run.z[:, column] == 1.0).all()
    assert run.variance[-1, column] == pytest.approx(adaptive.quantities[0].sd ** 2)


def test_a_car_that_stands_teaches_nothing(adaptive: Adaptive) -> None:
    # ten minutes, by the end of which the mass was at its lower bound
    noise, count = np.random.default_rng(1), round(600.0 / PERIOD_S)
    poses = noise.normal(size=(count, 3)) * NOISE.pose_sd
    z, P = start_filter(adaptive.formulas, NOISE, np.zeros(3), np.zeros(3), 0.0)
    run = run_filter(adaptive.filter, z, P, np.zeros((count, 2)), poses)
    for quantity in adaptive.quantities:
        column = adaptive.column(quantity.name)
        assert (run.z[:, column] == quantity.start).all()
        assert run.variance[:, column] == pytest.approx(quantity.sd**2)
    assert np.abs(run.z[-1, :3]).max() < 3.0 * NOISE.pose_sd.max()
    assert np.linalg.eigvalsh(P).min() > -1e-12
    # and what was learnt before stays, but for what is forgotten
    commands = draw_commands(60.0)
    driven = drive([adaptive.model], commands)
    driven[600:], commands[600:] = driven[600] + poses[:600], 0.0
    run, column = adaptive.run(commands, driven), adaptive.column("mass")
    assert run.z[-1, column] == run.z[700, column]
    assert run.z[-1, column] != 1.0
    assert run.variance[-1, column] > run.variance[700, column]


def test_what_was_learnt_fades_with_its_time_constant(adaptive: Adaptive) -> None:
    commands = draw_commands(60.0)
    poses = drive([adaptive.model], commands)
    poses[len(poses) // 2 :] = np.nan
    variance = adaptive.run(commands, poses).variance[:, adaptive.column("mass")]
    learnt, later, P_0 = variance[599], variance[-1], adaptive.quantities[0].sd ** 2
    faded = 1.0 - math.exp(-600 * PERIOD_S / NOISE.forget_s)
    assert later == pytest.approx(learnt + faded * (P_0 - learnt), rel=1e-9)


def test_a_gap_lets_forget_what_so_long_a_drive_without_poses_does(adaptive: Adaptive) -> None:
    n, commands = len(adaptive.formulas.states), draw_commands(60.0)
    z, P = start_filter(adaptive.formulas, NOISE, np.zeros(3), START_TWIST, 0.0)
    run_filter(adaptive.filter, z, P, commands, drive([adaptive.model], commands))
    learnt = P[n:, n:].copy()
    run_filter(adaptive.filter, z, P, commands[:400], np.full((400, 3), np.nan))
    known = Knowledge(z[n:], learnt, 400 * PERIOD_S)
    again, P_again = start_filter(adaptive.formulas, NOISE, np.zeros(3), START_TWIST, 0.0, known)
    assert (again[n:] == z[n:]).all()
    assert P_again[n:, n:] == pytest.approx(P[n:, n:], rel=1e-9)
    assert (np.diag(P_again[n:, n:]) > 1.1 * np.diag(learnt)).all()
    _, P_late = start_filter(adaptive.formulas, NOISE, np.zeros(3), START_TWIST, 0.0, known._replace(gap_s=1e6))
    assert P_late[n:, n:] == pytest.approx(np.diag([q.sd**2 for q in adaptive.quantities]))


def test_covariances_stay_symmetric_and_positive(adaptive: Adaptive) -> None:
    commands = draw_commands(60.0)
    z, P = start_filter(adaptive.formulas, NOISE, np.zeros(3), START_TWIST, 0.0)
    run_filter(adaptive.filter, z, P, commands, drive([adaptive.model], commands))
    assert np.abs(P - P.T).max() < 1e-12
    assert np.linalg.eigvalsh(P).min() > -1e-12


def test_one_wrong_pose_does_not_throw_the_filter_off(adaptive: Adaptive) -> None:
    commands = draw_commands(40.0)
    poses = drive([adaptive.model], commands)
    clean = adaptive.run(commands, poses)
    poses[600, 0] += 5.0
    wrong = adaptive.run(commands, poses)
    column = adaptive.column("mass")
    moved = abs(wrong.z[600, column] - clean.z[600, column])
    assert 0.0 < moved <= 2.0 * OUTLIER * math.sqrt(clean.variance[599, column])
    assert abs(wrong.z[-1, column] - clean.z[-1, column]) < 0.05


def test_a_start_of_which_only_the_pose_is_known_teaches_nothing_wrong() -> None:
    """The car goes on at 1 to 2 m/s, its wheel turned, while nobody says so."""
    noise = FilterNoise(
        np.array([5e-3, 5e-3, 1e-2]), np.array([5e-4, 5e-4, 1e-3]), np.full(3, 0.16), 0.1, np.full(3, 0.8), 0.5, 120.0
    )
    certain = make_adaptive("mass", noise=noise)
    column, n = certain.column("mass"), len(certain.formulas.states)
    off = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        drawn = np.column_stack([rng.uniform(-0.8, 0.8, 50), rng.uniform(0.8, 2.5, 50)])
        commands = np.repeat(drawn, round(2.0 / PERIOD_S), axis=0)
        poses = drive([certain.model], commands, seed, noise)
        z, P = start_filter(certain.formulas, noise, np.zeros(3), START_TWIST, 0.0)
        run_filter(certain.filter, z, P, commands[:1200], poses[:1200])
        known = Knowledge(z[n:].copy(), P[n:, n:].copy(), 3.0)
        z, P = start_filter(certain.formulas, noise, poses[1260], None, None, known)
        run = run_filter(certain.filter, z, P, commands[1261:], poses[1261:], settling_poses(certain.formulas))
        off.append(np.abs((run.z[:, column] - 1.0) / np.sqrt(run.variance[:, column])).max())
    # told that the car stands, two of these twelve are off by ten standard deviations and more
    assert max(off) < 4.0


def test_periods_without_a_pose_teach_no_twist(adaptive: Adaptive) -> None:
    commands = draw_commands(30.0)
    poses, column = drive([adaptive.model], commands), adaptive.column("mass")
    poses[:30] = np.nan
    z, P = start_filter(adaptive.formulas, NOISE, np.zeros(3), None, None)
    run = run_filter(adaptive.filter, z, P, commands, poses, settling_poses(adaptive.formulas))
    assert np.flatnonzero(run.z[:, column] != 1.0)[0] == 30 + round(SETTLING_S / PERIOD_S)


def test_what_is_learnt_waits_for_the_twist_alone(adaptive: Adaptive) -> None:
    commands = draw_commands(30.0)
    poses, column = drive([adaptive.model], commands), adaptive.column("mass")
    z, P = start_filter(adaptive.formulas, NOISE, np.zeros(3), None, None)
    run = run_filter(adaptive.filter, z, P, commands, poses, settling_poses(adaptive.formulas))
    assert np.flatnonzero(run.z[:, column] != 1.0)[0] == round(SETTLING_S / PERIOD_S)
    assert run.variance[-1, column] < 0.5 * adaptive.quantities[0].sd ** 2


@pytest.mark.parametrize("jump", [(1.0, 0.0, 0.3), (0.0, 0.0, math.pi), (-4.0, 9.0, -0.2)])
def test_an_origin_that_moves_is_followed(jump: tuple[float, ...], adaptive: Adaptive) -> None:
    commands = draw_commands(100.0)
    poses, column = drive([adaptive.model], commands), adaptive.column("mass")
    # turned about the old origin, and shifted
    x, y, turn = poses[1000:, 0].copy(), poses[1000:, 1].copy(), jump[2]
    poses[1000:, 0] = math.cos(turn) * x - math.sin(turn) * y + jump[0]
    poses[1000:, 1] = math.sin(turn) * x + math.cos(turn) * y + jump[1]
    poses[1000:, 2] += turn
    run = adaptive.run(commands, poses)
    there = np.abs(run.innovation[1000 + round(1.0 / PERIOD_S) :, :2])
    assert np.median(there) < 3e-3
    wrong = np.abs((run.z[1000:, column] - 1.0) / np.sqrt(run.variance[1000:, column]))
    assert wrong.max() < 4.0


def test_quantities_stay_within_their_bounds() -> None:
    light = make_adaptive("mass")
    model = with_quantities(light.model, [(light.quantities[0], 0.1)])
    commands = draw_commands(60.0)
    run = light.run(commands, drive([model], commands))
    low = light.quantities[0].low
    assert run.z[-1, -1] == low
    assert (run.z[:, -1] >= low).all()


def test_bounds_hold_for_quantities_that_take_each_other_along() -> None:
    both = make_adaptive("mass", "motor")
    z, P = start_filter(both.formulas, NOISE, np.zeros(3), START_TWIST, 0.0)
    n, (low, high) = len(both.formulas.states), (both.filter.low, both.filter.high)
    P[n:, n:] = 0.04 * np.array([[1.0, 0.95], [0.95, 1.0]])
    z[n:] = [low[0] - 0.5, high[1] + 0.5]
    keep_within(both.filter, z, P)
    assert (z[n:] >= low).all()
    assert (z[n:] <= high).all()


def test_yaw_is_compared_as_an_angle(adaptive: Adaptive) -> None:
    commands = draw_commands(20.0)
    poses = drive([adaptive.model], commands)
    turned = poses + np.array([0.0, 0.0, 2.0 * math.pi])
    assert adaptive.run(commands, turned).z[:, 0] == pytest.approx(adaptive.run(commands, poses).z[:, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ([], "nothing is named"),
        (["weight"], "nothing that can be adapted is called weight"),
        (["grip", "C_f"], "C_f would change twice"),
        (["K_v"], "this car has none"),
        (["rough_patch"], "where or when the effect acts is not known"),
        (["marker_offset"], "not said which parameter"),
        (["marker_offset.z"], "not said which parameter"),
    ],
)
def test_what_cannot_be_adapted_is_refused(names: list[str], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        choose_quantities(PLAIN, names)


ONE_SIDED = [
    f"{effect.id}.{p.symbol}"
    for effect in EFFECTS.values()
    for p in effect.parameters
    if p.low == p.off and not p.is_place and not effect.place_parameters and f"{effect.id}__{p.symbol}" not in TIMED
]
"""Parameters that cannot be below none, of effects that act everywhere and do not shift commands in time."""


@pytest.mark.parametrize("name", ONE_SIDED)
def test_what_cannot_be_less_than_none_stays_a_number_and_moves(name: str) -> None:
    """At none at all the slope of such an effect is zero, or no number: there it would stay for ever."""
    adaptive = make_adaptive(name)
    (quantity,) = adaptive.quantities
    truth = min(4.0 * quantity.start, quantity.high)
    commands = draw_commands(40.0)
    run = adaptive.run(commands, drive([with_quantities(adaptive.model, [(quantity, truth)])], commands))
    values = run.z[:, adaptive.column(name)]
    assert math.isfinite(run.log_likelihood)
    assert np.isfinite(run.variance).all()
    assert values.min() > 0.0
    # of what is shown, and does not begin at what is true, more is known in the end
    shown, column = run.variance[-1, adaptive.column(name)] < (0.7 * quantity.sd) ** 2, adaptive.column(name)
    if shown:
        off = abs(values[-1] - truth)
        assert off < max(abs(quantity.start - truth), 3.0 * math.sqrt(run.variance[-1, column]))
    # this car's motor does not come to a limit of its power
    assert values.std() > 0.0 or name == "motor_power_limit.inverse_P"


def test_a_pose_at_the_start_says_nothing_of_where_the_tracked_point_is() -> None:
    """The first state is reckoned from that pose by the assumed place: to see it once more is no news."""
    adaptive = make_adaptive("marker_offset.d_x")
    sd = adaptive.quantities[0].sd
    z, P = start_filter(adaptive.formulas, NOISE, np.zeros(3), START_TWIST, 0.0)
    poses, commands = np.full((20, 3), np.nan), np.zeros((20, 2))
    poses[:, 0], poses[:, 1:] = 0.5 * PERIOD_S * np.arange(1, 21), 0.0  # straight on
    run = run_filter(adaptive.filter, z, P, commands, poses)
    assert math.sqrt(run.variance[0, adaptive.column("marker_offset.d_x")]) > 0.9 * sd


def test_the_time_of_the_recording_goes_on_over_a_gap() -> None:
    """A load that came after 20 s is there after a gap at 40 s, too."""
    model = replace(PLAIN, effects={"mass_change__d": 0.2, "mass_change__t_s": 20.0})
    switched, quantities = choose_quantities(model, ["mass_change.d"])
    formulas = trace_adaptive(switched, quantities)
    column = [state.name for state in formulas.states].index("t")
    known = Knowledge(np.array([0.2]), np.array([[0.01]]), 5.0, 45.0)
    assert start_filter(formulas, NOISE, np.zeros(3), START_TWIST, 0.0, known)[0][column] == 45.0
    assert start_filter(formulas, NOISE, np.zeros(3), START_TWIST, 0.0)[0][column] == 0.0


def test_what_lasts_of_what_a_model_lacks_widens_its_errors() -> None:
    """Pushes that last a second are no news each period; a filter that takes them for such is too sure of the mass."""
    lasting = NOISE._replace(forget_s=1e6, lasting_sd=(0.15, 0.15, 0.15))
    off = list[list[float]]()
    for noise in (lasting, lasting._replace(lasting_sd=(0.0, 0.0, 0.0), q=NOISE.q * 2.0)):
        adaptive = make_adaptive("mass", noise=noise)
        off.append([])
        for seed in range(16):
            commands = draw_commands(30.0, seed)
            run = adaptive.run(commands, drive([adaptive.model], commands, seed, lasting), noise)
            column = adaptive.column("mass")
            off[-1].append((run.z[-1, column] - 1.0) / math.sqrt(run.variance[-1, column]))
    told, untold = (float(np.mean(np.square(each))) for each in off)
    assert 0.4 < told < 1.8
    assert untold > told


def test_limits_that_no_drive_reached_are_released() -> None:
    def model_stating(**errors: float | None) -> NewtonEuler:
        about = {symbol: {"relative_se": error, "low": 1.0} for symbol, error in errors.items()}
        return NewtonEuler(CAR, PERIOD_S, {"fitted": about, "at_bound": ["F_f_max"]})

    assert unreached_limits(model_stating(F_r_max=None, F_f_max=0.02, C_r=None)) == ("F_r_max",)
    assert (
        unreached_limits(model_stating(F_r_max=0.9, F_f_max=0.1)) == ()
    )  # known badly, or at a bound, but not tested away
    at_low = model_stating(F_r_max=None)
    assert unreached_limits(replace(at_low, car=CAR._replace(F_r_max=1.0))) == ()  # a floor without grip
    assert unreached_limits(PLAIN) == ()
    car = release_limits(PLAIN, ["F_r_max"]).car
    assert car.F_r_max == pytest.approx(9.81 * CAR.m)
    assert car._replace(F_r_max=CAR.F_r_max) == CAR


@pytest.mark.skipif(GCC is None, reason="there is no C compiler here")
@pytest.mark.parametrize("names", [("mass", "steering_offset"), ("marker_offset.d_x", "mass_change.d")])
def test_the_filter_in_c_is_the_same(names: tuple[str, ...], tmp_path: Path) -> None:
    """With effects that depend on time, and on where the tracked point is, as well."""
    timed = {"mass_change__d": 0.2, "mass_change__t_s": 5.0}
    model = PLAIN if "mass" in names else replace(PLAIN, effects=timed)
    adaptive = make_adaptive(*names, noise=C_NOISE, model=model)
    (tmp_path / "car_adapt.h").write_text(write_adapt_header("car", "car", adaptive.formulas, COMMANDS))
    source = write_adapt_source("car", "car", adaptive.formulas, adaptive.filter, C_NOISE)
    (tmp_path / "car_adapt.c").write_text(source)
    strict = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC"]
    subprocess.run([str(GCC), *strict, "car_adapt.c", "-o", "car.so", "-lm"], cwd=tmp_path, check=True)
    commands = draw_commands(40.0)
    # five seconds in which the car comes to a stand
    commands[100:200] = 0.0
    poses = drive([adaptive.model], commands)
    poses[300:320], poses[500, 1], poses[650:, 0] = np.nan, 9.0, poses[650:, 0] + 2.0
    run = adaptive.run(commands, poses, C_NOISE)
    c = load_c(tmp_path / "car.so")
    memory = (ctypes.c_double * (len(run.z[0]) + len(run.z[0]) ** 2))()
    c.car_adapt_init(memory, numbers([0.0] * 3), numbers(START_TWIST), 0.0)
    assert np.abs(step_in_c(c, memory, commands, poses) - run.z).max() < 1e-9
    # after a gap what is known of the quantities goes on, less what is forgotten over it
    n = len(adaptive.formulas.states)
    z, P = start_filter(adaptive.formulas, C_NOISE, np.zeros(3), START_TWIST, 0.0)
    run_filter(adaptive.filter, z, P, commands, poses)
    ended_s = len(commands) * PERIOD_S
    gap_s, pose, twist, rows = 20.0, poses[399], np.array([0.8, 0.0, 0.1]), slice(400, 600)
    known = Knowledge(z[n:], P[n:, n:], gap_s, ended_s + gap_s)
    z, P = start_filter(adaptive.formulas, C_NOISE, pose, twist, 0.2, known)
    kept = P.copy()
    again = run_filter(adaptive.filter, z, P, commands[rows], poses[rows])
    c.car_adapt_restart(memory, numbers(pose), numbers(twist), 0.2, gap_s)
    assert np.abs(np.array(memory[len(z) :]).reshape(kept.shape) - kept).max() < 1e-12
    assert np.abs(step_in_c(c, memory, commands[rows], poses[rows]) - again.z).max() < 1e-9
    # one of which only the pose is known, with some periods without a pose
    poses[405:410] = np.nan
    known = Knowledge(z[n:], P[n:, n:], gap_s, known.time_s + 200 * PERIOD_S + gap_s)
    z, P = start_filter(adaptive.formulas, C_NOISE, pose, None, None, known)
    kept = P.copy()
    again = run_filter(adaptive.filter, z, P, commands[rows], poses[rows], settling_poses(adaptive.formulas))
    c.car_adapt_restart(memory, numbers(pose), None, math.nan, gap_s)
    assert np.abs(np.array(memory[len(z) :]).reshape(kept.shape) - kept).max() < 1e-12
    assert np.abs(step_in_c(c, memory, commands[rows], poses[rows]) - again.z).max() < 1e-9


def numbers(row: Sequence[float] | Floats) -> Any:
    """An array in C."""
    return (ctypes.c_double * len(row))(*row)


def load_c(library: Path) -> Any:
    """The functions of the compiled library."""
    c, pointer = ctypes.CDLL(str(library)), ctypes.POINTER(ctypes.c_double)
    c.car_adapt_init.argtypes = [ctypes.c_void_p, pointer, pointer, ctypes.c_double]
    c.car_adapt_restart.argtypes = [ctypes.c_void_p, pointer, pointer, ctypes.c_double, ctypes.c_double]
    c.car_adapt_step.argtypes = [ctypes.c_void_p, pointer, pointer]
    return c


def step_in_c(c: Any, memory: Any, commands: Floats, poses: Floats) -> Floats:
    """z after each pose; where none was measured, NULL and NaN in turns."""
    found, count = [], round((-1 + math.sqrt(1 + 4 * len(memory))) / 2)
    for k, (command, pose) in enumerate(zip(commands, poses, strict=True)):
        c.car_adapt_step(memory, numbers(command), None if np.isnan(pose[0]) and k % 2 else numbers(pose))
        found.append(memory[:count])
    return np.array(found)

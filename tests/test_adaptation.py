"""A car that learns while it drives: what the filter estimates, and that it says so in C as well."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from exported_models import CAR

from bcid.adaptation.c_source import write_adapt_header, write_adapt_source
from bcid.adaptation.filter import OUTLIER, CompiledFilter, FilterNoise, compile_filter, run_filter, start_filter
from bcid.adaptation.formulas import AdaptiveFormulas, trace_adaptive
from bcid.adaptation.quantities import AdaptedQuantity, choose_quantities, with_quantities
from bcid.aliases import Floats
from bcid.effects.constants import Constants
from bcid.errors import UsageError
from bcid.evaluation.closed_loop import integrate_poses
from bcid.export.formulas import COMMANDS
from bcid.export.reference_drive import history_of_start
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler

GCC = shutil.which("gcc")
PERIOD_S = 0.05
START_TWIST = np.array([0.5, 0.0, 0.0])
NOISE = FilterNoise(
    np.array([0.02, 0.02, 0.03]), np.array([1e-3, 1e-3, 2e-3]), np.array([0.3, 0.3, 0.5]), 0.1, forget_s=30.0
)
PLAIN = AugmentedNewtonEuler(CAR, {}, Constants(), 2.0, 100.0, PERIOD_S, {})


class Adaptive(NamedTuple):
    model: AugmentedNewtonEuler
    quantities: tuple[AdaptedQuantity, ...]
    formulas: AdaptiveFormulas
    filter: CompiledFilter

    def run(self, commands: Floats, poses: Floats) -> Any:
        z, P = start_filter(self.formulas, NOISE, np.zeros(3), START_TWIST, 0.0)
        return run_filter(self.filter, z, P, commands, poses)

    def column(self, name: str) -> int:
        return len(self.formulas.states) + [q.name for q in self.quantities].index(name)


def make_adaptive(*names: str, noise: FilterNoise = NOISE) -> Adaptive:
    model, quantities = choose_quantities(PLAIN, names)
    formulas = trace_adaptive(model, quantities)
    return Adaptive(model, quantities, formulas, compile_filter(formulas, noise))


@pytest.fixture(scope="module")
def adaptive() -> Adaptive:
    return make_adaptive("mass", "steering_offset")


def draw_commands(seconds: float, seed: int = 0) -> Floats:
    rng, count = np.random.default_rng(seed), round(seconds)
    drawn = np.column_stack([rng.uniform(-0.8, 0.8, count), rng.uniform(0.0, 1.5, count)])
    return np.repeat(drawn, round(1.0 / PERIOD_S), axis=0)


def drive(models: list[AugmentedNewtonEuler], commands: Floats, seed: int = 0) -> Floats:
    """Poses, with noise, of a car that is each of `models` for an equal part of the time."""
    carry = models[0].init(history_of_start(models[0], np.zeros(3), START_TWIST, 0.0))
    twists = [START_TWIST]
    for part, model in zip(np.array_split(commands, len(models)), models, strict=True):
        for command in part:
            carry, twist = model.step(carry, command)
            twists.append(twist)
    poses = integrate_poses(np.zeros(3), np.array(twists), PERIOD_S)[1:]
    noisy: Floats = poses + np.random.default_rng(seed).normal(size=poses.shape) * NOISE.pose_sd
    return noisy


def test_a_passenger_is_weighed_within_ten_seconds(adaptive: Adaptive) -> None:
    mass, offset = adaptive.quantities
    cars = [with_quantities(adaptive.model, [(mass, m), (offset, 0.03)]) for m in (1.0, 1.2)]
    commands = draw_commands(120.0)
    run = adaptive.run(commands, drive(cars, commands))
    at = lambda seconds, name: run.z[round(seconds / PERIOD_S), adaptive.column(name)]  # noqa: E731
    assert at(59.0, "mass") == pytest.approx(1.0, abs=0.1)
    assert np.median(run.z[1400:, adaptive.column("mass")]) == pytest.approx(1.2, rel=0.05)
    assert at(110.0, "steering_offset") == pytest.approx(0.03, abs=0.01)


def test_stated_deviations_cover_what_is_off(adaptive: Adaptive) -> None:
    mass, offset = adaptive.quantities
    model = with_quantities(adaptive.model, [(mass, 1.1), (offset, 0.02)])
    off = []
    for seed in range(12):
        commands = draw_commands(40.0, seed)
        run = adaptive.run(commands, drive([model], commands, seed))
        for name, true in (("mass", 1.1), ("steering_offset", 0.02)):
            column = adaptive.column(name)
            off.append((run.z[-1, column] - true) / math.sqrt(run.variance[-1, column]))
    # the filter's pushes are more than there are here, so that what it says is cautious
    assert 0.02 < np.mean(np.square(off)) < 1.5


def test_a_filter_that_is_not_told_poses_learns_nothing(adaptive: Adaptive) -> None:
    commands = draw_commands(10.0)
    run = adaptive.run(commands, np.full((len(commands), 3), np.nan))
    column = adaptive.column("mass")
    assert run.log_likelihood == 0.0
    assert (run.z[:, column] == 1.0).all()
    assert run.variance[-1, column] == pytest.approx(adaptive.quantities[0].sd ** 2)


def test_what_was_learnt_fades_with_its_time_constant(adaptive: Adaptive) -> None:
    commands = draw_commands(60.0)
    poses = drive([adaptive.model], commands)
    poses[len(poses) // 2 :] = np.nan
    variance = adaptive.run(commands, poses).variance[:, adaptive.column("mass")]
    learnt, later, P_0 = variance[599], variance[-1], adaptive.quantities[0].sd ** 2
    faded = 1.0 - math.exp(-600 * PERIOD_S / NOISE.forget_s)
    assert later == pytest.approx(learnt + faded * (P_0 - learnt), rel=1e-9)


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


def test_quantities_stay_within_their_bounds() -> None:
    light = make_adaptive("mass")
    model = with_quantities(light.model, [(light.quantities[0], 0.1)])
    commands = draw_commands(60.0)
    run = light.run(commands, drive([model], commands))
    low = light.quantities[0].low
    assert run.z[-1, -1] == low
    assert (run.z[:, -1] >= low).all()


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


@pytest.mark.skipif(GCC is None, reason="there is no C compiler here")
def test_the_filter_in_c_is_the_same(adaptive: Adaptive, tmp_path: Path) -> None:
    (tmp_path / "car_adapt.h").write_text(write_adapt_header("car", "car", adaptive.formulas, COMMANDS))
    source = write_adapt_source("car", "car", adaptive.formulas, adaptive.filter, NOISE)
    (tmp_path / "car_adapt.c").write_text(source)
    strict = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC"]
    subprocess.run([str(GCC), *strict, "car_adapt.c", "-o", "car.so", "-lm"], cwd=tmp_path, check=True)
    commands = draw_commands(40.0)
    poses = drive([adaptive.model], commands)
    poses[300:320], poses[500, 1] = np.nan, 9.0
    run = adaptive.run(commands, poses)
    found = run_in_c(tmp_path / "car.so", len(run.z[0]), commands, poses)
    assert np.abs(found - run.z).max() < 1e-9


def run_in_c(library: Path, numbers: int, commands: Floats, poses: Floats) -> Floats:
    """z after each pose, by the compiled library."""
    c, pointer = ctypes.CDLL(str(library)), ctypes.POINTER(ctypes.c_double)
    c.car_adapt_init.argtypes = [ctypes.c_void_p, pointer, pointer, ctypes.c_double]
    c.car_adapt_step.argtypes = [ctypes.c_void_p, pointer, pointer]
    memory = (ctypes.c_double * (numbers + numbers**2))()
    numbers_of = lambda row: (ctypes.c_double * len(row))(*row)  # noqa: E731
    c.car_adapt_init(memory, numbers_of([0.0] * 3), numbers_of(START_TWIST), 0.0)
    found = []
    for command, pose in zip(commands, poses, strict=True):
        c.car_adapt_step(memory, numbers_of(command), None if np.isnan(pose[0]) else numbers_of(pose))
        found.append(memory[:numbers])
    return np.array(found)

"""FMUs of FMI 2.0 and 3.0: valid, as exact as the model, and lenient in nothing that an importer could get wrong."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.aliases import Floats
from bcid.effects.constants import Constants
from bcid.errors import InputRefused
from bcid.evaluation.closed_loop import integrate_poses
from bcid.export.check import C_FLAGS, find_compiler
from bcid.export.exported import Exported, export_model
from bcid.export.fmi.check_fmus import check_fmus, drive_fmu
from bcid.export.fmi.description import list_variables
from bcid.export.fmi.fmu import write_fmus, write_texts
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed")
if find_compiler() is None:
    pytest.skip("no C compiler was found", allow_module_level=True)

PERIOD_S, STEPS = 0.1, 200  # 20 s
CAR = Car(
    m=3.5, I_z=0.06, l_f=0.15, l_r=0.17, T_s=0.08, d=0.4, F_m_max=12.0, K_t=9.0, K_b=5.0, C_f=15.0, C_r=18.0,
    F_f_max=14.0, F_r_max=16.0, R_1=1.1, R_2=0.2, v_0=1.0,
)  # fmt: skip
DELAYED = {"steering_delay__tau": 0.13, "motor_delay__tau": 0.2, "steering_lag__tau": 0.05}
VERSIONS = {"fmi3": "small_car.fmu", "fmi2": "small_car_fmi2.fmu"}

OUTPUTS = ("p_x", "p_y", "theta", "v_x", "v_y", "yaw_rate")

Made = tuple[Exported, Path]
Said = pytest.CaptureFixture[str]

both_versions = pytest.mark.parametrize("version", VERSIONS)


def make_export(effects: Mapping[str, float]) -> Exported:
    model = AugmentedNewtonEuler(CAR, effects, Constants(), 0.4, 60.0, PERIOD_S, {}) if effects else None
    return export_model(model or NewtonEuler(CAR, PERIOD_S, {}), "0" * 64, None, "small_car")


@pytest.fixture(scope="module", params=["newton-euler", "with delays"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """What is make_export, and the folder of its FMUs."""
    e = make_export({} if request.param == "newton-euler" else DELAYED)
    folder = tmp_path_factory.mktemp("fmus")
    for name, content in write_fmus(e).items():
        (folder / name).write_bytes(content)
    return e, folder


class Slave:
    """An instance of an FMU, as an importer calls it."""

    def __init__(self, e: Exported, instance: Any) -> None:
        self.e, self.instance = e, instance
        self.reference = {v.quantity.name: v.reference for v in list_variables(e)}
        kind = "Real" if hasattr(instance, "getReal") else "Float64"
        self._get, self._set = (getattr(instance, f"{verb}{kind}") for verb in ("get", "set"))

    def get(self, *names: str) -> list[float]:
        return list(self._get([self.reference[name] for name in names]))

    def set(self, **values: float) -> None:
        self._set([self.reference[name] for name in values], list(values.values()))

    def begin(self, start_s: float = 0.0, stop_s: float | None = None) -> None:
        v = self.e.vectors
        times = {"startTime": start_s, "stopTime": stop_s}
        if hasattr(self.instance, "setupExperiment"):
            self.instance.setupExperiment(**times)
            times = {}
        names = [name for name in self.reference if name.endswith("_0")]
        self.set(**dict(zip(names, [*v.pose, *v.twist, v.delta], strict=True)))
        self.instance.enterInitializationMode(**times)
        self.instance.exitInitializationMode()

    def drive(self, first: int, last: int, start_s: float = 0.0) -> Floats:
        """The poses and twists (last - first, 6) after each command, a period each."""
        rows = []
        for k in range(first, last):
            u_s, u_m = self.e.vectors.commands[k]
            self.set(u_s=u_s, u_m=u_m)
            self.instance.doStep(start_s + k * PERIOD_S, PERIOD_S)
            rows.append(self.get(*OUTPUTS))
        return np.array(rows)


@contextmanager
def slave(made: Made, version: str) -> Iterator[Slave]:
    """An instance that is freed in the end."""
    e, folder = made
    path = str(folder / VERSIONS[version])
    unzipped = fmpy.extract(path, unzipdir=str(folder / version))
    description = fmpy.read_model_description(path)
    instance = fmpy.instantiate_fmu(unzipped, description, "CoSimulation")
    try:
        yield Slave(e, instance)
    finally:
        instance.freeInstance()


@both_versions
def test_fmpy_finds_no_problem(made: Made, version: str) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(made[1] / VERSIONS[version])) == []


def test_both_do_what_the_model_does_for_twenty_seconds(made: Made) -> None:
    error = check_fmus(made[1], made[0]).error
    assert error is not None
    assert error < 1e-9


@both_versions
def test_start_times_other_than_zero_change_nothing(made: Made, version: str) -> None:
    e, folder = made
    driven = drive_fmu(folder / VERSIONS[version], e, start_s=7.3)
    np.testing.assert_allclose(driven[:, 3:], e.vectors.twists, atol=1e-9)


@both_versions
def test_poses_are_those_of_the_twists(made: Made, version: str) -> None:
    e = made[0]
    twists = np.vstack([e.vectors.twist, e.vectors.twists])
    with slave(made, version) as car:
        car.begin()
        poses = car.drive(0, STEPS)[:, :3]
    np.testing.assert_allclose(poses, integrate_poses(e.vectors.pose, twists, PERIOD_S)[1:], atol=1e-9)


@both_versions
def test_two_periods_a_step_give_every_second_row(made: Made, version: str) -> None:
    u_s, u_m = made[0].vectors.commands[0]
    with slave(made, version) as car:
        car.begin()
        car.set(u_s=u_s, u_m=u_m)
        single = []
        for k in range(40):
            car.instance.doStep(k * PERIOD_S, PERIOD_S)
            single.append(car.get(*OUTPUTS))
        car.instance.reset()
        car.begin()
        car.set(u_s=u_s, u_m=u_m)
        for k in range(20):
            car.instance.doStep(2 * k * PERIOD_S, 2 * PERIOD_S)
            assert car.get(*OUTPUTS) == single[2 * k + 1]


@both_versions
def test_steps_may_change_from_one_to_the_next(made: Made, version: str) -> None:
    with slave(made, version) as car:
        car.begin()
        car.set(u_s=0.2, u_m=1.0)
        car.instance.doStep(0.0, 3 * PERIOD_S)
        car.instance.doStep(3 * PERIOD_S, PERIOD_S)
        after = car.get("p_x", "v_x")
        car.instance.reset()
        car.begin()
        car.set(u_s=0.2, u_m=1.0)
        car.instance.doStep(0.0, 4 * PERIOD_S)
        assert car.get("p_x", "v_x") == after


@both_versions
@pytest.mark.parametrize(
    ("now_s", "step_s", "words"),
    [
        (0.0, 1.5 * PERIOD_S, "whole number of periods of 0.1 s, and this one would last 0.15 s"),
        (0.0, 0.0, "whole number of periods"),
        (0.0, -PERIOD_S, "whole number of periods"),
        (PERIOD_S, PERIOD_S, "the communication point is 0.1 s, where the vehicle is at 0 s"),
        (0.0, 60 * PERIOD_S, "after the stop time of 5 s"),
    ],
)
def test_any_other_step_is_refused_and_changes_nothing(
    made: Made, version: str, now_s: float, step_s: float, words: str, capsys: Said
) -> None:
    with slave(made, version) as car:
        car.begin(stop_s=5.0)
        with pytest.raises(fmpy.fmi1.FMICallException, match="DoStep failed with status 3"):
            car.instance.doStep(now_s, step_s)
        assert words in capsys.readouterr().out
        np.testing.assert_allclose(car.drive(0, 20)[:, 3:], made[0].vectors.twists[:20], atol=1e-9)


@both_versions
def test_a_model_that_leaves_the_finite_numbers_says_so_and_stays(made: Made, version: str, capsys: Said) -> None:
    with slave(made, version) as car:
        if version == "fmi2":
            car.instance.setupExperiment()
        car.set(v_x_0=1e200)
        car.instance.enterInitializationMode()
        car.instance.exitInitializationMode()
        with pytest.raises(fmpy.fmi1.FMICallException):
            car.instance.doStep(0.0, PERIOD_S)
        assert "the model leaves the finite numbers at 0.1 s" in capsys.readouterr().out
        assert car.get(*OUTPUTS) == [0.0, 0.0, 0.0, 1e200, 0.0, 0.0]


@both_versions
def test_a_million_seconds_into_a_simulation_steps_are_still_whole(made: Made, version: str) -> None:
    start_s = 1e6 + 1.0 / 3.0
    with slave(made, version) as car:
        car.begin(start_s)
        now_s = start_s
        for u_s, u_m in made[0].vectors.commands:
            car.set(u_s=u_s, u_m=u_m)
            car.instance.doStep(now_s, PERIOD_S)
            now_s += PERIOD_S
        np.testing.assert_allclose(car.get("v_x", "v_y", "yaw_rate"), made[0].vectors.twists[-1], atol=1e-9)
        if version == "fmi3":
            assert car.instance.getFloat64([0]) == [start_s + STEPS * PERIOD_S]  # the time


@both_versions
def test_a_saved_state_replays_to_the_last_bit(made: Made, version: str) -> None:
    with slave(made, version) as car:
        car.begin()
        car.drive(0, 30)
        state = car.instance.getFMUState()
        kept = car.instance.serializeFMUState(state)
        first = car.drive(30, 80)
        car.instance.setFMUState(state)
        np.testing.assert_array_equal(car.drive(30, 80), first)
        car.instance.freeFMUState(state)
    with slave(made, version) as other:
        state = other.instance.deserializeFMUState(kept)
        other.instance.setFMUState(state)
        other.instance.freeFMUState(state)
        np.testing.assert_array_equal(other.drive(30, 80), first)


@both_versions
def test_a_state_of_another_model_is_refused(made: Made, version: str, capsys: Said) -> None:
    with slave(made, version) as car:
        state = car.instance.getFMUState()
        kept = car.instance.serializeFMUState(state)
        car.instance.freeFMUState(state)
        for spoiled, words in ((b"x" + kept[1:], "of another model"), (kept[:-1], "a serialized state has")):
            with pytest.raises(fmpy.fmi1.FMICallException):
                car.instance.deserializeFMUState(spoiled)
            assert words in capsys.readouterr().out


@both_versions
def test_a_reset_vehicle_is_as_it_was_instantiated(made: Made, version: str) -> None:
    with slave(made, version) as car:
        names = list(car.reference)
        before = car.get(*names)
        car.begin()
        first = car.drive(0, 50)
        car.instance.terminate()
        car.instance.reset()
        assert car.get(*names) == before
        car.begin()
        np.testing.assert_array_equal(car.drive(0, 50), first)


@both_versions
def test_a_vehicle_at_rest_without_commands_stays(made: Made, version: str) -> None:
    with slave(made, version) as car:
        car.instance.enterInitializationMode()
        car.instance.exitInitializationMode()
        car.instance.doStep(0.0, 10 * PERIOD_S)
        assert car.get(*OUTPUTS) == [0.0] * 6


@both_versions
def test_outputs_are_the_start_before_the_first_step(made: Made, version: str) -> None:
    with slave(made, version) as car:
        car.begin()
        v = made[0].vectors
        assert car.get(*OUTPUTS) == [*v.pose, *v.twist]
        assert car.get("x.delta") == [v.delta]


@both_versions
@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"v_x": 1.0}, "it is no input and no parameter"),
        ({"x.delta": 0.1}, "it is no input and no parameter"),
        ({"v_x_0": 1.0}, "cannot be set after initialization"),
        ({"u_s": float("nan")}, "cannot be nan"),
    ],
)
def test_what_is_not_to_be_set_is_refused(
    made: Made, version: str, values: dict[str, float], words: str, capsys: Said
) -> None:
    with slave(made, version) as car:
        car.begin()
        with pytest.raises(fmpy.fmi1.FMICallException):
            car.set(**values)
        assert words in capsys.readouterr().out


@both_versions
def test_calls_out_of_turn_are_refused(made: Made, version: str, capsys: Said) -> None:
    with slave(made, version) as car:
        with pytest.raises(fmpy.fmi1.FMICallException):
            car.instance.doStep(0.0, PERIOD_S)
        assert "while the vehicle is stepping, and it is instantiated" in capsys.readouterr().out


@pytest.mark.parametrize("version", [2, 3])
def test_prototypes_and_types_agree_with_the_headers_of_the_standard(made: Made, version: int, tmp_path: Path) -> None:
    compiler, headers = find_compiler(), Path(fmpy.__file__).parent / "c-code"
    assert compiler is not None
    for path, text in write_texts(made[0], version).items():
        (tmp_path / Path(path).name).write_text(text)
    (tmp_path / "sizes.c").write_text(SIZES[version])
    standard = ["-include", str(headers / f"fmi{version}Functions.h")]
    said = []
    for flags in (standard, []):
        sources = [f"fmu-fmi{version}.c", "sizes.c", "small_car.c"]
        built = [compiler, *C_FLAGS, "-Werror", *flags, "-I.", *sources, "-lm", "-o", "sizes"]
        subprocess.run(built, cwd=tmp_path, check=True, timeout=60)
        said.append(subprocess.run(["./sizes"], cwd=tmp_path, check=True, capture_output=True, timeout=60).stdout)
    assert said[0] == said[1] != b""


SIZES = {
    2: """\
#include <stdio.h>
#include "fmi2-interface.h"
#define AT(field) printf(#field " %u\\n", (unsigned int)offsetof(fmi2CallbackFunctions, field));
int main(void)
{
    AT(logger) AT(allocateMemory) AT(freeMemory) AT(stepFinished) AT(componentEnvironment)
    printf("%u\\n", (unsigned int)sizeof(fmi2CallbackFunctions));
    printf("%d %d %d %d %d %d\\n", fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending);
    printf("%d %d\\n", fmi2ModelExchange, fmi2CoSimulation);
    printf("%d %d %d %d\\n", fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated);
    return 0;
}
""",
    3: """\
#include <stdio.h>
#include "fmi3-interface.h"
#define SIZE(type) printf(#type " %u %d\\n", (unsigned int)sizeof(type), (type)-1 < 0);
int main(void)
{
    SIZE(fmi3Float32) SIZE(fmi3Float64) SIZE(fmi3Int8) SIZE(fmi3Int16) SIZE(fmi3Int32) SIZE(fmi3Int64) SIZE(fmi3Char)
    printf("%u %u\\n", (unsigned int)sizeof(fmi3ValueReference), (unsigned int)sizeof(fmi3Boolean));
    printf("%d %d %d %d %d\\n", fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal);
    printf("%d %d %d %d %d %d\\n", fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent);
    printf("%d %d %d\\n", fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged);
    return 0;
}
""",
}


def test_the_same_model_gives_the_same_bytes_and_another_one_another_token() -> None:
    e = make_export({})
    assert write_fmus(e) == write_fmus(e)
    tokens = {
        write_texts(one, version)["sources/fmu-model.h"].partition("TOKEN ")[2].partition("\n")[0]
        for one in (e, make_export(DELAYED))
        for version in (2, 3)
    }
    assert len(tokens) == 4


def test_an_fmu_that_is_another_model_is_refused(made: Made, tmp_path: Path) -> None:
    other = make_export({} if made[0].formulas.states[0].name == "p_x" else {"motor_delay__tau": 0.1})
    for name, content in write_fmus(other).items():
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputRefused, match="does not do what the model does: it is off by"):
        check_fmus(tmp_path, made[0])


def test_an_fmu_of_a_model_with_a_network_may_be_off_by_twenty_times_a_step(made: Made, tmp_path: Path) -> None:
    e, folder = made
    shifted = e.vectors._replace(twists=e.vectors.twists + 1e-8)
    with pytest.raises(InputRefused, match="off by 1e-08"):
        check_fmus(folder, replace(e, vectors=shifted))
    own = shifted._replace(states=np.zeros((STEPS, len(e.formulas.states))))
    assert check_fmus(folder, replace(e, vectors=own)).error == pytest.approx(1e-8, rel=1e-3)

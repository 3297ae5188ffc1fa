"""`bcid export`: names, options, compilers that do not work, and what is told of all this."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from exported_models import MODELS, augmented_car, make_export, no_progress, written
from typer.testing import CliRunner

from bcid import libraries
from bcid.cli.app import app
from bcid.documents.export import ExportDocument
from bcid.errors import InputRefused, PartLost, UsageError
from bcid.evaluation.process_noise import ProcessNoise
from bcid.evaluation.validity import DataRange, ModelValidity
from bcid.export import check
from bcid.export.check import NO_COMPILER, Checked, check_c, compile_c, find_compiler, run_program
from bcid.export.exported import Exported, export_model
from bcid.export.formats import FORMATS
from bcid.export.reference_drive import EXACT, STEPS
from bcid.export.write import write_export
from bcid.models.saving import save_model

VALIDITY = ModelValidity(
    ProcessNoise((0.02, 0.02, 0.02), 0.0, 2.0, 3.0),
    DataRange((-0.5, -0.4, -1.0, -2.0, -0.3, -1.0), (2.0, 0.4, 1.0, 2.0, 0.3, 1.0)),
)


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, list(arguments), catch_exceptions=True)


def test_the_command_writes_files_and_says_how_exact_they_are(tmp_path: Path) -> None:
    save_model(MODELS["newton-euler"], tmp_path)
    out = tmp_path / "out"
    said = run("export", str(tmp_path), "--format", "python", "--out", str(out), "--name", "my_car", "--output", "json")
    assert said.exit_code == 0, said
    document = json.loads(said.stdout)
    assert {path.name for path in out.iterdir()} == {"my_car.py", "my_car_test.py", "my_car.json"}
    assert document["formats"][0]["error"] < EXACT
    assert document["states"][0]["name"] == "v_x"
    assert len(document["vectors"]["commands"]) == STEPS
    again = subprocess.run([sys.executable, out / "my_car_test.py"], capture_output=True, text=True, check=True)
    assert float(again.stdout) == document["formats"][0]["error"]


def test_a_format_brings_what_it_needs(tmp_path: Path) -> None:
    document = written(make_export("newton-euler"), ["ros2"], tmp_path)
    assert [made.format for made in document.formats] == ["python", "ros2"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--format", "fortran"], "there is no format 'fortran'"), (["--as", "wish"], "as recording or as vehicle"),
        (["--name", "my car"], "cannot be a name"), (["--format", "parameters", "--name", "3d"], "cannot be a name"),
    ],
)  # fmt: skip
def test_wrong_options_are_told_and_nothing_is_written(options: list[str], said: str, tmp_path: Path) -> None:
    save_model(MODELS["k-sindy"], tmp_path)
    done = run("export", str(tmp_path), "--out", str(tmp_path / "out"), *options)
    assert isinstance(done.exception, UsageError)
    assert said in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_what_is_there_is_not_written_over(tmp_path: Path) -> None:
    save_model(MODELS["newton-euler"], tmp_path)
    (tmp_path / "newton_euler.py").write_text("mine", encoding="utf-8")
    done = run("export", str(tmp_path), "--format", "python", "--out", str(tmp_path))
    assert isinstance(done.exception, InputRefused)
    assert (tmp_path / "newton_euler.py").read_text(encoding="utf-8") == "mine"
    assert not (tmp_path / "newton_euler.json").exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "cannot be a name in C"), ("3d", "cannot be a name in C"), ("class", "a word of C or of Python"),
        ("in", "a word of C"), ("struct", "a word of C"), ("math", "in place of the module"),
        ("sys", "in place of the module"), ("typing", "in place of the module"), ("casadi", "in place of the module"),
        ("numpy", "in place of the module"), ("acados_template", "in place of the module"),
    ],
)  # fmt: skip
def test_names_that_would_break_a_file_are_refused(name: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        export_model(MODELS["k-sindy"], "0" * 64, None, name)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize(
    "name",
    ["first", "start", "states", "model", "network", "largest", "fmi2", "fmi3", "fmu_model", "fmu_vehicle", "x", "e"],
)
def test_names_that_the_files_themselves_use_do_no_harm(name: str, tmp_path: Path) -> None:
    formats = ["c", "python", "casadi", "acados", "fmi"]
    for made in written(export_model(MODELS["newton-euler"], "0" * 64, None, name), formats, tmp_path).formats:
        assert made.error is None or made.error < EXACT


def test_a_relative_folder_is_as_good_as_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "model").mkdir()
    save_model(MODELS["newton-euler"], tmp_path / "model")
    monkeypatch.chdir(tmp_path)
    said = run("export", "model", "--format", "c", "--format", "python", "--output", "json")
    assert said.exit_code == 0, said.exception
    assert all(made["error"] is None or made["error"] < EXACT for made in json.loads(said.stdout)["formats"])
    assert {path.name for path in Path("export").iterdir()} >= {"newton_euler.c", "newton_euler_test.py"}
    assert not Path("export/newton_euler_test").exists()


def test_a_compiler_that_does_not_work_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "gcc"
    broken.write_text("#!/bin/sh\necho no headers >&2\nexit 1\n", encoding="utf-8")
    broken.chmod(0o755)
    works = find_compiler()
    found = {"cc": str(broken), "gcc": works, "clang": None}
    monkeypatch.setattr(check.shutil, "which", found.get)
    assert find_compiler() == works
    found["gcc"] = None
    assert find_compiler() is None
    document = written(make_export("newton-euler"), ["c"], tmp_path / "out")
    assert (document.formats[0].error, document.formats[0].not_checked) == (None, NO_COMPILER)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_what_does_not_compile_is_said_not_to(tmp_path: Path) -> None:
    for file in ("car.c", "car_test.c"):
        (tmp_path / file).write_text("int nothing(void) { return here; }\n", encoding="utf-8")
    with pytest.raises(InputRefused, match="does not compile"):
        check_c(tmp_path, "car")
    compiler = find_compiler()
    assert compiler is not None
    (tmp_path / "unused.c").write_text("int main(void) { int unused = 1; return 0; }\n", encoding="utf-8")
    compile_c(compiler, ["unused.c"], tmp_path / "unused", "C")  # a warning is no error at a user's
    with pytest.raises(InputRefused, match="unused variable"):
        compile_c(compiler, ["unused.c"], tmp_path / "unused", "C", ["-Werror"])


def test_what_does_not_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check, "LONGEST_RUN_S", 0.2)
    with pytest.raises(InputRefused, match=r"has not ended after 0\.2 s"):
        run_program([sys.executable, "-c", "import time; time.sleep(20)"], tmp_path, "Python")


def test_a_format_whose_library_is_missing_is_not_left_out_in_silence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_model(MODELS["k-sindy"], tmp_path)
    monkeypatch.setattr("bcid.export.formats.is_installed", lambda name: False)
    monkeypatch.setattr("bcid.export.fmi.check_fmus.is_installed", lambda name: False)
    said = run("export", str(tmp_path), "--out", str(tmp_path / "out"))
    assert said.exit_code == 0, said.exception
    told = " ".join(said.stderr.split())
    assert f"onnx was left out: onnx is not installed next: {libraries.install_command('onnx')}" in told
    assert "parameters" not in told


def test_a_default_export_warns_of_nothing_that_could_not_be_otherwise(tmp_path: Path) -> None:
    save_model(MODELS["newton-euler"], tmp_path)
    said = run("export", str(tmp_path), "--format", "parameters", "--out", str(tmp_path / "out"))
    assert said.exit_code == 0, said.exception
    assert "warning" not in said.stderr


def test_options_that_would_change_nothing_are_refused() -> None:
    for model in (MODELS["k-sindy"], MODELS["newton-euler"], augmented_car({"steering_drag__k": 20.0})):
        with pytest.raises(UsageError, match="no effects of how poses were measured"):
            export_model(model, "0" * 64, None, of_vehicle=True)
        with pytest.raises(UsageError, match="depends on the time of the recording"):
            export_model(model, "0" * 64, None, time_s=3.0)
    assert export_model(augmented_car({"motor_sag__s": 0.2}), "0" * 64, None, time_s=3.0).time_s == 3.0
    assert export_model(augmented_car({"clock_drift__rho": 1e-4}), "0" * 64, None, time_s=3.0).time_s == 3.0


def test_what_is_exported_says_of_which_point_it_is(tmp_path: Path) -> None:
    effects = {"steering_drag__k": 20.0, "marker_offset__d_x": 0.2, "throttle_timing__tau": 0.02}
    for of_vehicle, point in ((False, "tracked point"), (True, "centre of gravity")):
        e = export_model(augmented_car(effects), "0" * 64, VALIDITY, "car", of_vehicle=of_vehicle)
        folder = tmp_path / point.partition(" ")[0]
        document = written(e, ["c", "python", "casadi"], folder)
        assert document.point == point
        assert all(q.meaning.endswith(f"of the {point}") for q in document.twist)
        assert all(q.meaning.endswith("of the centre of gravity") for q in document.states if q.name in ("p_x", "v_y"))
        # ranges are those of the point that was tracked
        ranges = {q.name: (q.low, q.high) for q in document.twist}
        assert ranges["v_y"] == ((None, None) if of_vehicle else (-0.4, 0.4))
        assert ranges["yaw_rate"] == (-1.0, 1.0)
        assert {(q.low, q.high) for q in document.states if q.name == "v_y"} == {(None, None)}
        for file in ("car.h", "car.py", "car_casadi.py"):
            assert f"are of the {point}" in (folder / file).read_text(encoding="utf-8")
        assert any("u_m_ago" in q.name for q in document.states) != of_vehicle


def test_a_format_that_fails_costs_itself_and_what_needs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(folder: Path, e: Exported) -> Checked:
        raise InputRefused(folder / "car_casadi.py", "casadi", "does not do what the model does", "report this")

    monkeypatch.setitem(FORMATS, "casadi", replace(FORMATS["casadi"], check=refuse))
    assert FORMATS["acados"].needs == ("casadi",)
    e = export_model(MODELS["newton-euler"], "0" * 64, None, "car")
    document = written(e, ["python", "acados"], tmp_path / "some")
    assert [made.format for made in document.formats] == ["python"]
    assert set(document.refused) == {"casadi", "acados"}
    assert {p.name for p in (tmp_path / "some").iterdir()} == {"car.py", "car_test.py", "car.json"}
    with pytest.raises(PartLost, match=r"casadi is not written: .*does not do what the model does"):
        document.raise_if_refused()
    with pytest.raises(InputRefused, match="does not do what the model does"):
        written(e, ["casadi"], tmp_path / "none")
    assert not (tmp_path / "none").exists()
    # what lies there of another model would lie beside what is written of this one
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "car_casadi.py").write_text("another car", encoding="utf-8")
    with pytest.raises(InputRefused, match="does not do what the model does"):
        write_export(e, ["python", "casadi"], tmp_path / "old", lambda path: True, no_progress)
    assert [p.name for p in (tmp_path / "old").iterdir()] == ["car_casadi.py"]


def test_commands_say_what_they_mean_to_the_model(tmp_path: Path) -> None:
    document = written(make_export("newton-euler-augmented"), ["python"], tmp_path)
    steering, throttle = document.commands
    assert document.steering_limit_rad == 1.2
    assert "clipped beyond 1.2 rad" in steering.meaning
    assert throttle.unit == "m/s"
    assert "below zero the share of full brake" in throttle.meaning
    assert "a brake with a command of its own stays off" in throttle.meaning
    read = ExportDocument.read(tmp_path / "newton_euler_augmented.json")
    assert read.vectors.starts[0].state == document.vectors.starts[0].state
    assert len(read.vectors.end_pose) == 3

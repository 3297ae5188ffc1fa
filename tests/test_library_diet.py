"""The libraries of extras are imported by what needs them only; all else runs without, and what needs them says so."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import ROOT
from faults.saved import models

from bcid.cli.app import main
from bcid.cli.exits import describe_error
from bcid.errors import LibraryMissing
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.libraries import EXTRAS
from bcid.models.interface import FitTask
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.saving import save_model
from bcid.models.settings import NewtonEulerSettings
from bcid.models.table import FITTABLE
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

BROUGHT_ALONG = {"sympy", "networkx", "mpmath"}  # by torch

BLOCKED = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {EXTRAS.keys() | BROUGHT_ALONG}:
            raise ModuleNotFoundError(f"{{name}} is blocked", name=name)

sys.meta_path.insert(0, Absent())
"""

EVERY_MODULE = """
import importlib, pkgutil
import bcid

refused = []
for module in pkgutil.walk_packages(bcid.__path__, "bcid."):
    if not module.name.endswith("__main__"):
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError:
            refused.append(module.name)
print(*refused)
"""

COMMANDS = """
from bcid.cli.app import app

for command in {commands}:
    app([*command, "--format", "quiet"], standalone_mode=False)
print(*sys.modules)
"""


def run_without_libraries(code: str) -> str:
    """What `code` prints in a process of its own, where the libraries of the extras cannot be imported."""
    done = subprocess.run([sys.executable, "-c", BLOCKED + code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Makes a library as good as not installed."""
    return lambda name: monkeypatch.setitem(sys.modules, name, None)


def fails(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    """Exit code and message of a command that fails."""
    monkeypatch.setattr(sys, "argv", ["bcid", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert isinstance(ended.value.code, int)
    return ended.value.code, capsys.readouterr().err


def test_only_the_genetic_engine_and_a_peer_need_them_to_be_imported() -> None:
    assert run_without_libraries(EVERY_MODULE).split() == ["bcid.estimate.reference", "bcid.models.fitting.genetic"]


def test_the_table_of_extras_is_that_of_the_installation() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = {extra: {r.partition(">")[0] for r in rows} for extra, rows in project["optional-dependencies"].items()}
    for extra in set(EXTRAS.values()):
        assert names[extra] == {library for library, e in EXTRAS.items() if e == extra}
    assert not EXTRAS.keys() & {r.partition(">")[0] for r in project["dependencies"]}
    wanted = f'-e ".[{",".join(dict.fromkeys(EXTRAS.values()))},dev]"'
    for file in ("Makefile", "docs/quickstart.md"):
        assert wanted in (ROOT / file).read_text(encoding="utf-8"), file


@pytest.mark.parametrize("name", [name for name, row in FITTABLE.items() if row.trained_by])
def test_a_network_without_torch_is_refused_before_anything_is_done(
    name: str, takes: dict[str, Path], vehicle_file: Path, tmp_path: Path, without: Callable[[str], None],
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    without("torch")
    out = tmp_path / "w"
    words = ("fit", takes["motive"], "--model", "newton-euler", "--model", name, "--vehicle", vehicle_file)
    code, text = fails(monkeypatch, capsys, *words, "--out", out)
    assert code == 2
    assert f"training {name} needs the library torch, which is not installed" in text
    assert 'next: pip install "bcid[networks]"' in text
    assert not out.exists()


def test_the_whole_job_without_torch_is_refused_before_anything_is_done(
    takes: dict[str, Path], vehicle_file: Path, tmp_path: Path, without: Callable[[str], None],
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    without("torch")
    pipeline = write_pipeline(tmp_path, takes, vehicle_file, list(FITTABLE))
    code, text = fails(monkeypatch, capsys, "run", "-p", pipeline)
    assert (code, "training narx-mlp needs the library torch" in text) == (2, True)
    assert not (tmp_path / "workspace").exists()


def test_a_blind_test_with_baselines_needs_pysindy(
    tmp_path: Path, without: Callable[[str], None], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    without("pysindy")
    code, text = fails(monkeypatch, capsys, "prove", "--quick", "--out", tmp_path / "proof")
    assert (code, "--baselines, which --quick runs too, needs the library pysindy" in text) == (2, True)
    assert 'pip install "bcid[checks]"' in text
    assert not (tmp_path / "proof").exists()


def test_the_reference_filter_needs_filterpy(
    recording: Recording, vehicle: Vehicle, tuning: Tuning, without: Callable[[str], None]
) -> None:
    without("filterpy")
    with pytest.raises(LibraryMissing, match=r'engine = "filterpy" of \[estimate\] needs the library filterpy'):
        estimate_motion(recording, vehicle, tuning, engine="filterpy")


def test_the_genetic_optimiser_needs_deap(
    estimates: list[Estimate], vehicle: Vehicle, without: Callable[[str], None]
) -> None:
    without("deap")
    settings = NewtonEulerSettings(optimiser="genetic").model_dump(mode="json")
    with pytest.raises(LibraryMissing, match=r'optimiser = "genetic" of \[fit.newton-euler\] needs the library deap'):
        NewtonEuler.fit(FitTask(estimates, vehicle, settings, 1))


def test_a_command_that_meets_a_missing_library_on_its_way_says_how_to_install_it() -> None:
    text, code = describe_error(ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn"))
    assert code == 2
    assert text == 'this command needs the library torch, which is not installed\n  next: pip install "bcid[networks]"'
    assert "internal error" in describe_error(ModuleNotFoundError("No module named 'other'", name="other"))[0]


def write_pipeline(folder: Path, takes: dict[str, Path], vehicle_file: Path, names: list[str]) -> Path:
    """A pipeline file that fits `names` to one simulated take and compares them on another."""
    training, validation = takes["motive"].as_posix(), takes["other"].as_posix()
    path = folder / "pipeline.toml"
    path.write_text(
        f'vehicle = "{vehicle_file.as_posix()}"\ntraining = ["{training}"]\nvalidation = "{validation}"\n'
        f"models = {json.dumps(names)}\n[report]\ntiming_repeats = 0\n"
    )
    return path


@pytest.mark.slow
def test_a_recording_is_ingested_estimated_diagnosed_and_its_model_driven(tmp_path: Path, vehicle_file: Path) -> None:
    take, out = tmp_path / "take.csv", tmp_path / "out"
    of_take = [str(take), "--vehicle", str(vehicle_file), "--out", str(out)]
    simulate = ["simulate", "take", "--out", str(tmp_path), "--duration", "60"]
    commands = [simulate, *([stage, *of_take] for stage in ("ingest", "estimate", "diagnose"))]
    run_without_libraries(COMMANDS.format(commands=commands))
    assert json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))["verdict"]
    model = ["--model", str(out / "model"), "--commands", str(tmp_path / "take.commands.csv")]
    run_without_libraries(COMMANDS.format(commands=[["simulate", "driven", "--out", str(tmp_path), *model]]))
    assert (tmp_path / "driven.csv").is_file()


@pytest.mark.slow
def test_models_are_fitted_and_saved_networks_compared_and_driven(
    tmp_path: Path, takes: dict[str, Path], vehicle_file: Path
) -> None:
    """All that needs no training; the networks were saved where torch is, and are compared as fits of others."""
    white = [name for name, row in FITTABLE.items() if row.trained_by is None]
    pipeline = write_pipeline(tmp_path, takes, vehicle_file, white)
    networks = [name for name, row in FITTABLE.items() if row.trained_by]
    for name in networks:
        (tmp_path / name).mkdir()
        save_model(models()[name], tmp_path / name)
    stages = [[stage, "-p", str(pipeline)] for stage in ("ingest", "estimate", "fit")]
    compared = [
        "report",
        "-p",
        str(pipeline),
        *(word for name in networks for word in ("--model", str(tmp_path / name))),
    ]
    commanded = ["--commands", str(takes["other"].with_suffix(".commands.csv"))]
    driven = [["simulate", n, "--out", str(tmp_path), "--model", str(tmp_path / n), *commanded] for n in networks]
    loaded = run_without_libraries(COMMANDS.format(commands=[*stages, compared, *driven])).splitlines()[-1].split()
    assert not {name.partition(".")[0] for name in loaded} & (EXTRAS.keys() | BROUGHT_ALONG | {"sklearn"})
    report = json.loads((tmp_path / "workspace" / "report" / "report.json").read_text(encoding="utf-8"))
    assert {m["model"] for m in report["models"]} == {*white, *networks}
    assert all((tmp_path / f"{name}.csv").is_file() for name in networks)

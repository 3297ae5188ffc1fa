"""Heavy libraries are imported by what needs them only: everything from a recording to its diagnosis runs without."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BLOCKED = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"torch", "pysindy", "filterpy", "deap"}:
            raise ModuleNotFoundError(f"{name} is blocked")

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
"""


def run_without_libraries(code: str) -> str:
    """What `code` prints in a process of its own, where the heavy libraries cannot be imported."""
    done = subprocess.run([sys.executable, "-c", BLOCKED + code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_only_the_genetic_engine_and_a_peer_need_them_to_be_imported() -> None:
    assert run_without_libraries(EVERY_MODULE).split() == ["bcid.estimate.reference", "bcid.models.fitting.genetic"]


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

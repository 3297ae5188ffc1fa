"""Kills at random moments of a whole pipeline: the next run must end with the bytes of an undisturbed one."""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.samples import VEHICLE, SampleTake, write_sample_take

PIPELINE = """\
vehicle = "../car.toml"
training = ["../first.csv", "../second.mcap"]
validation = "../third.csv"
workspace = "workspace"
seed = 1
models = ["newton-euler", "k-sindy"]
[report]
timing_repeats = 0
"""


def prepared(folder: Path) -> None:
    """Takes and a vehicle file."""
    (folder / "car.toml").write_text(VEHICLE)
    for i, (name, kind) in enumerate((("first", "motive"), ("second", "mcap"), ("third", "motive"))):
        write_sample_take(folder, SampleTake(name, kind, 60.0), Plant(**REAL_EXTRAS), Sensor(), 20 + i)  # type: ignore[arg-type]


def start(folder: Path, name: str) -> subprocess.Popen[bytes]:
    """A run of the pipeline in a folder of its own; pages tell the command and the date, so that both are the same."""
    home = folder / name
    home.mkdir(exist_ok=True)
    (home / "pipeline.toml").write_text(PIPELINE)
    words = [sys.executable, "-m", "bcid", "run", "-p", "pipeline.toml", "--format", "quiet"]
    same = {**os.environ, "SOURCE_DATE_EPOCH": "1800000000"}
    return subprocess.Popen(
        words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True, cwd=home, env=same
    )


def workspace_of(folder: Path, name: str) -> Path:
    """Where the run called `name` leaves its artifacts."""
    return folder / name / "workspace"


def contents(workspace: Path) -> dict[str, str]:
    """Digest by name of all that a run leaves."""
    found = {}
    for path in sorted(workspace.rglob("*")):
        name = path.relative_to(workspace).as_posix()
        stage = name.split("/")[0]
        if path.is_file() and not stage.startswith("."):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def one_kill(folder: Path, number: int, lasts_s: float, whole: dict[str, str]) -> tuple[str, str]:
    """What came of a kill: `same`, or what differs; and the stage that it fell into."""
    rng = np.random.default_rng([7, number])
    name = f"killed_{number}"
    run = start(folder, name)
    time.sleep(float(rng.uniform(0.0, lasts_s)))
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    stages = [p.name for p in workspace_of(folder, name).glob("*") if not p.name.startswith(".")]
    again = start(folder, name)
    _, text = again.communicate()
    found = contents(workspace_of(folder, name))
    outcome = "same"
    if again.returncode != 0:
        outcome = f"exit {again.returncode}: {text.decode(errors='replace')[-300:]}"
    elif found != whole:
        outcome = f"differs: {sorted(k for k in found.keys() | whole.keys() if found.get(k) != whole.get(k))[:5]}"
    shutil.rmtree(folder / name, ignore_errors=True)
    return outcome, f"{len(stages)} stages begun"


def killed(n: int, workers: int, report: Callable[[str], None]) -> tuple[dict[str, Any], bool]:
    """The counts of `n` kills, and whether any failed; `report` is told how far it is."""
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        prepared(folder)
        for names in (("warm",), ("whole", "twice", *map(str, range(2, workers)))):  # as many at once as will be killed
            begun = time.monotonic()
            for run in [start(folder, name) for name in names]:
                _, text = run.communicate()
                if run.returncode != 0:
                    raise RuntimeError(text.decode(errors="replace"))
            lasts_s = time.monotonic() - begun
        whole, twice = contents(workspace_of(folder, "whole")), contents(workspace_of(folder, "twice"))
        with ThreadPoolExecutor(workers) as pool:
            rows = []
            for row in pool.map(lambda k: one_kill(folder, k, lasts_s, whole), range(n)):
                rows.append(row)
                report(f"kill {len(rows)} of {n}: {row[0]}")
    outcomes, stages = Counter(o for o, _ in rows), Counter(s for _, s in rows)
    figures = {"kills": n, "undisturbed_s": round(lasts_s, 1), "two_runs_the_same": whole == twice,
               "outcomes": dict(outcomes), "fell_into": dict(sorted(stages.items()))}  # fmt: skip
    return figures, set(outcomes) != {"same"} or whole != twice

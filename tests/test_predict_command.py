"""`bcid predict`: what it writes and says, and what it refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exported_models import MODELS

import bcid
from bcid.evaluation.process_noise import ProcessNoise
from bcid.evaluation.validity import DataRange, ModelValidity
from bcid.models.saving import save_model

ROOT = Path(__file__).parent.parent
RANGE = DataRange((-1.0, -1.0, -3.0, -3.0, -0.3, 0.0), (3.0, 1.0, 3.0, 3.0, 0.3, 2.0))


def predict(folder: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bcid", "predict", *map(str, words)], cwd=folder, capture_output=True, text=True,
        check=False, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=300,
    )  # fmt: skip


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a saved model that knows its data, one that does not, and commands that leave them."""
    folder = tmp_path_factory.mktemp("lab")
    for name in ("known", "unknown"):
        (folder / name).mkdir()
        save_model(MODELS["newton-euler-augmented"], folder / name)
    ModelValidity(ProcessNoise((0.02, 0.02, 0.02), 0.0, 2.0, 3.0), RANGE).save(folder / "known")
    (folder / "c.csv").write_text("time_s,steering_rad,throttle_mps\n0,0.1,1.0\n1,0.5,1.0\n2,0.0,1.0\n")
    return folder


def test_the_table_is_that_of_the_prediction(lab: Path) -> None:
    state = ["--state", "v_x=0.8,delta=0.1", "--sd", "v_x=0.05"]
    done = predict(lab, "known", "--commands", "c.csv", *state, "--out", "p.csv")
    assert done.returncode == 0, done.stderr
    assert "newton-euler-augmented predicts" in done.stdout
    assert (
        "warning: beyond the data it was fitted on: u_s is 0.5 rad at 1.0 s, the takes go up to 0.3 rad" in done.stderr
    )
    assert "the covariance is of the start, what the model lacks in its own takes (process noise)" in done.stderr
    with pytest.warns(bcid.BeyondData):
        expected = bcid.predict(lab / "known", lab / "c.csv", bcid.State(v_x=0.8, delta=0.1, sd={"v_x": 0.05}))
    expected.write(lab / "own.csv")
    assert (lab / "own.csv").read_bytes() == (lab / "p.csv").read_bytes()
    again = predict(lab, "known", "--commands", "c.csv", *state, "--out", "p.csv")
    assert again.returncode == 4
    assert "exists already" in again.stderr
    assert predict(lab, "known", "--commands", "c.csv", *state, "--out", "p.csv", "--force").returncode == 0


def test_scripts_are_told_what_is_not_known(lab: Path) -> None:
    done = predict(lab, "unknown", "--commands", "c.csv", "--duration", "1", "--out", "p.parquet", "--format", "json")
    told = json.loads(done.stdout)
    assert told["file"] == "p.parquet"
    assert told["rows"] == 51
    assert "no process noise is known of this model" in told["caveats"]
    assert (lab / "p.parquet").is_file()
    assert np.isclose(told["to_s"], 1.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("known", "name a file with --commands"), ("known --commands c.csv --out p.txt", "is written as .csv or"),
        ("known --from t.csv --vehicle v.toml", "--from and --at go together"),
        ("known --at 3 --commands c.csv", "--from and --at go together"),
        ("known --from t.csv --at 3", "--from needs --vehicle"),
        ("known --from t.csv --at 3 --vehicle v.toml --state x=1", "leave --from or --state out"),
        ("known --commands c.csv --vehicle v.toml", "goes with --from"),
        ("known --commands c.csv --from-commands c.csv", "--from-commands goes with --from"),
        ("known --commands c.csv --state speed=1", "--state: 'speed=1'"),
        ("known --commands c.csv --out c.csv --force", "would be written over"),
        ("known --from p.csv[0:2] --at 1 --vehicle v.toml --out p.csv --force", "would be written over"),
        ("known --from t.csv --from-commands c.csv --at 1 --vehicle v.toml --out c.csv --force", "would be written"),
        ("known --from c.csv --at 1 --vehicle v.toml --out c.commands.csv --force", "would be written over"),
        ("known --commands c.csv --duration 0", "a duration"),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_refused(lab: Path, words: str, said: str) -> None:
    done = predict(lab, *words.split())
    assert done.returncode in (2, 4), done.stderr
    assert said in done.stderr
    assert "next:" in done.stderr
    assert not (lab / "prediction.csv").exists()

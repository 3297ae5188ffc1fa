"""The fair comparison: the same takes for our models and their peers, and what counts as missed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, chi2

from bcid.bench import peers
from bcid.bench.accuracy import compare_models, read_accuracy_file, summarise_accuracy
from bcid.bench.limits import RECOVERY
from bcid.bench.parameters import fit_simulated_take
from bcid.bench.parameters import summarise_recovery as recovered
from bcid.errors import InputRefused

pytestmark = [  # deepSI leaves its files open
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

DATA = """\
pipeline = "pipeline.toml"
[[data]]
name = "short"
simulated_s = 60.0
validation_s = 25.0
[[data]]
name = "real"
vehicle = "v.toml"
training = ["a.csv"]
validation = "b.csv"
"""


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    folder = tmp_path_factory.mktemp("accuracy")
    (folder / "pipeline.toml").write_text(
        'vehicle = "v.toml"\ntraining = ["t"]\nmodels = ["newton-euler", "k-sindy"]\n'
    )
    (folder / "data.toml").write_text(DATA)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(peers, "EPOCHS", 15)
        patch.setattr(peers, "ITERATIONS", 20)
        patch.setattr(peers, "VALIDATION_INTERVAL", 10)
        ((name, plan),) = read_accuracy_file(folder / "data.toml", None, folder)
        return list(compare_models(name, plan, [1, 2]))


def test_ours_and_peers_are_judged_on_the_same_take(rows: list[dict[str, Any]]) -> None:
    expected = {"newton-euler", "k-sindy", "torch MLP", "pysindy"} | (
        {"deepSI SUBNET"} if find_spec("deepSI") else set()
    )
    assert {r["model"] for r in rows} == expected
    assert len(rows) == 2 * len(expected)
    for r in rows:
        assert r["validation"].startswith("validation_1_25s_")
        assert set(r["horizons"]) == {"0.5 s", "2 s", "10 s", "end"}
    by = {(r["model"], r["seed"]): r["horizons"] for r in rows}
    for model in ("newton-euler", "torch MLP", "pysindy"):  # a minute teaches each of them to see half a second ahead
        assert by[model, 1]["0.5 s"]["nmse"] < 0.3
    assert by["newton-euler", 1]["end"]["nmse"] < 0.05
    assert by["torch MLP", 1]["0.5 s"] != by["torch MLP", 2]["0.5 s"]


def test_the_outcome_takes_medians_and_says_what_is_missed() -> None:
    def row(model: str, ours: bool, seed: int, end: float | None, data: str = "simulated hour") -> dict[str, Any]:
        value = None if end is None else {"nmse": end, "ci95": [0.5 * end, 2.0 * end]}
        return {"data": data, "model": model, "ours": ours, "seed": seed, "horizons": {"2 s": value, "end": value}}

    found = summarise_accuracy(
        [
            row("newton-euler", True, 1, 3e-3), row("k-mlp", True, 1, 2e-3), row("k-mlp", True, 2, 2.4e-3),
            row("k-mlp", True, 3, 2.2e-3),
            row("k-sindy-mlp", True, 1, 6e-3), row("torch MLP", False, 1, None), row("pysindy", False, 1, 2.1e-3),
        ],
        {"machine": {}},
    )  # fmt: skip
    lines = {line["model"]: line for line in found["table"]}
    assert lines["k-mlp"]["end"]["nmse"] == 2.2e-3
    assert lines["k-mlp"]["end"]["ci95"] == [1.1e-3, 4.4e-3]
    assert lines["torch MLP"]["end"]["nmse"] is None
    assert found["missed"] == [
        "simulated hour, k-mlp: seeds change 18 % at the end",
        "simulated hour, 2 s: pysindy 2.10, newton-euler 3.00",
        "simulated hour, 2 s: pysindy 2.10, k-mlp 2.20",
        "simulated hour, 2 s: pysindy 2.10, k-sindy-mlp 6.00",
        "simulated hour, end: pysindy 2.10, newton-euler 3.00",
        "simulated hour, end: pysindy 2.10, k-mlp 2.20",
        "simulated hour, end: pysindy 2.10, k-sindy-mlp 6.00",
        "simulated hour: k-sindy-mlp is not below newton-euler",
        "simulated hour: k-sindy-mlp is above 5",
    ]


def test_what_diverges_is_missed() -> None:
    fine, lost = {"nmse": 1e-3, "ci95": [0.0, 1.0]}, None
    rows = [
        {"data": "DART", "model": "k-mlp", "ours": True, "seed": seed, "horizons": {"end": end}}
        for seed, end in ((1, fine), (2, lost))
    ]
    assert summarise_accuracy(rows, {})["missed"] == ["DART, k-mlp: diverges (end)"]


def test_a_file_of_data_with_problems_is_refused(tmp_path: Path) -> None:
    (tmp_path / "data.toml").write_text('pipelin = "x"\n')
    with pytest.raises(InputRefused, match="did you mean pipeline"):
        list(read_accuracy_file(tmp_path / "data.toml", None, tmp_path))


TAKES = 16


@pytest.mark.slow
def test_fits_to_poses_state_intervals_that_hold_and_one_step_fits_do_not() -> None:
    """Over many small fits of the paper's car; constants of one fit are nearly independent of each other.

    Of half as many takes it hung on the machine which constants a one-step fit tells, and so how far off they are.
    """
    rows = [row for seed in range(300, 300 + TAKES) for row in fit_simulated_take(seed, 50.0, ["one-step", "poses"])]
    table = {(r["loss"], r["symbol"]): r for r in recovered(rows, {})["rows"]}
    poses, one_step = table["poses", "all"], table["one-step", "all"]
    n = poses["n"]
    assert n >= TAKES * 7
    low, high = (
        binom.ppf([0.005, 0.995], n, RECOVERY.coverage) / n
    )  # the goal's ends, as so many intervals can tell them
    assert low <= poses["covered"] <= high
    squares = chi2.ppf([1e-4, 1.0 - 1e-4], n) / n  # of errors in standard errors: twice too wide would be a quarter
    assert squares[0] < poses["rms_in_errors"] ** 2 < 1.3 * squares[1]  # constants of one fit go together a little
    assert abs(poses["bias_in_errors"]) < 0.5
    assert one_step["covered"] < RECOVERY.coverage[0]
    assert one_step["rms_in_errors"] ** 2 > chi2.ppf(1.0 - 1e-4, one_step["n"]) / one_step["n"]  # larger than stated
    assert one_step["median_error"] > 5.0 * poses["median_error"]
    biased = table["one-step", "R_1"]
    assert biased["bias_in_errors"] < -1.0
    assert abs(table["poses", "R_1"]["bias_in_errors"]) < 1.0


def test_a_constant_that_a_take_does_not_show_is_not_told() -> None:
    """The rear tyre never slides in half a minute of town driving: its grip is not quoted."""
    rows = fit_simulated_take(7, 45.0, ["poses"])
    assert {"K_t", "C_f", "C_r", "I_z", "F_f_max"} <= {r["symbol"] for r in rows}
    assert "F_r_max" not in {r["symbol"] for r in rows}
    assert all(np.isfinite(r["relative_se"]) for r in rows)


def test_a_limit_that_a_few_samples_touch_is_not_told() -> None:
    """Fits leave the rear grip where the largest forces are: it has a slope there, and could as well be endless."""
    told = [r["symbol"] for r in fit_simulated_take(28, 60.0, ["poses"])]
    told += [r["symbol"] for seed in range(1, 7) for r in fit_simulated_take(seed, 60.0, ["one-step", "rollout"])]
    assert "F_r_max" not in told
    assert told.count("F_f_max") >= 5  # which is reached


def test_what_a_peer_cannot_fit_is_told_and_the_others_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unable(estimates: object, seed: int) -> peers.TorchMlp:
        raise AssertionError("too few")

    (tmp_path / "pipeline.toml").write_text('vehicle = "v.toml"\ntraining = ["t"]\nmodels = []\n')
    (tmp_path / "data.toml").write_text(DATA)
    monkeypatch.setattr(peers.TorchMlp, "fit", unable)
    monkeypatch.setattr("bcid.bench.accuracy.PEERS", {"torch": peers.TorchMlp, "pysindy": peers.PySindy})
    ((name, plan),) = read_accuracy_file(tmp_path / "data.toml", None, tmp_path)
    first, second = compare_models(name, plan, [1])
    assert first["error"] == "AssertionError: too few"
    assert set(first["horizons"].values()) == {None}
    assert second["horizons"]["0.5 s"]["nmse"] > 0.0


@pytest.mark.slow
def test_several_processes_give_the_same_rows_in_the_same_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pipeline.toml").write_text(
        'vehicle = "v.toml"\ntraining = ["t"]\nmodels = ["k-sindy", "newton-euler-linear"]\n'
    )
    (tmp_path / "data.toml").write_text(DATA)
    monkeypatch.setattr("bcid.bench.accuracy.PEERS", {})
    ((name, plan),) = read_accuracy_file(tmp_path / "data.toml", None, tmp_path)
    together = list(compare_models(name, plan, [1, 2], workers=2))
    assert [(r["seed"], r["model"]) for r in together] == [(seed, m) for seed in (1, 2) for m in plan.models]
    alone = plan.model_copy(update={"workspace": tmp_path / "alone"})
    assert together == list(compare_models(name, alone, [1, 2]))

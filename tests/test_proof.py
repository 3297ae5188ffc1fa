"""The blind test's own honesty: cases, the wall between answer and diagnosis, and the counting."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from bcid.cli.app import main
from bcid.effects.table import EFFECTS
from bcid.proof import running
from bcid.proof.cases import Case, suite
from bcid.proof.concealed import MEASUREMENT, SIZES
from bcid.proof.running import recorded, run_all, vehicle
from bcid.proof.scoring import tiers


def test_every_effect_of_the_vocabulary_can_be_concealed() -> None:
    assert set(SIZES) == set(EFFECTS)
    assert set(MEASUREMENT) == {n for n, e in EFFECTS.items() if e.kind == "measurement"}
    for name, effect in EFFECTS.items():
        main = effect.parameters[0]
        assert SIZES[name].low <= main.size <= SIZES[name].high, name


def test_a_suite_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    one, same, other = (list(suite(seed, 1, 2, 2, 2)) for seed in (1, 1, 2))
    assert one == same
    assert one != other
    assert len({c.name for c in one}) == len(one)
    for case in one:
        for concealed in case.concealed:
            assert set(concealed.parameters) == {p.symbol for p in EFFECTS[concealed.effect].parameters}


def test_the_diagnosis_is_handed_no_answer() -> None:
    case = next(c for c in suite(1, 1, 0, 0, 0) if c.answer == ("yaw_scrub",))
    recording = recorded(case, vehicle())
    words = [v for v in _leaves(asdict(recording)) if isinstance(v, str)]
    assert "concealed" in words
    assert not [w for w in words if "yaw" in w or "scrub" in w or "single" in w]
    numbers = {float(v) for v in _leaves(asdict(recording)) if isinstance(v, int | float)}
    assert case.concealed[0].parameters["c"] not in numbers


def _leaves(tree: Any) -> list[Any]:
    if isinstance(tree, dict):
        return [leaf for value in tree.values() for leaf in _leaves(value)]
    if isinstance(tree, list | tuple):
        return [leaf for value in tree for leaf in _leaves(value)]
    return [tree]


def test_rows_are_kept_by_case_and_made_again_after_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def fake(case: Case) -> dict[str, Any]:
        made.append(case.name)
        if case.seed == 1 and len(made) == 1:
            raise ValueError("no such luck")
        return row(case.name, list(case.answer), list(case.answer))

    monkeypatch.setattr(running, "run_case", fake)
    cases = list(suite(1, 1, 2, 0, 0))[:3]
    first = list(run_all(cases, tmp_path, 1))
    assert ["error" in r for r in first] == [True, False, False]
    assert not any("error" in r for r in run_all(cases, tmp_path, 1))
    assert len(made) == 4
    list(run_all(list(suite(2, 1, 2, 0, 0))[:3], tmp_path, 1))
    assert len(made) == 7  # another seed's cases of the same names are others
    (tmp_path / next(p.name for p in tmp_path.iterdir())).write_text("{")
    list(run_all(cases + list(suite(2, 1, 2, 0, 0))[:3], tmp_path, 1))
    assert len(made) == 8  # a broken file is made again


def row(case: str, answer: list[str], found: list[str], **more: Any) -> dict[str, Any]:
    findings = [
        {"effect": e, "kind": EFFECTS[e].kind, "twins": [], "probability": 1.0, "gain": 100.0, "heldout": 90.0,
         "values": {EFFECTS[e].parameters[0].symbol: [1.02, 0.02]}}
        for e in found
    ]  # fmt: skip
    truth = {e: {EFFECTS[e].parameters[0].symbol: 1.0} for e in answer}
    verdict = "named" if found else "nothing-found"
    base = {"case": case, "tier": "single", "answer": answer, "channel": "", "verdict": verdict, "findings": findings}
    return {**base, "remainder": {"channel": "fx"}, "truth": truth, "seconds": 1.0, **more}


def test_counting() -> None:
    rows = [
        row("single-0001", ["yaw_scrub"], ["yaw_scrub"]),
        row("single-0002", ["yaw_scrub"], ["rear_toe"]),
        row("single-0003", ["pose_scale"], ["pose_scale", "rear_toe"]),
        row("null-0004", [], [], tier="null"),
        row("null-0005", [], ["rear_toe"], tier="null"),
        {"case": "null-0007", "tier": "null", "answer": [], "channel": "", "error": "ValueError()"},
        row("left-out-0006", ["yaw_scrub"], [], tier="left-out", channel="mz", verdict="unknown",
            remainder={"channel": "mz"}),
    ]  # fmt: skip
    single, null, hidden = tiers(rows)
    assert {"top1", "set", "kind"} <= set(single.missed)
    assert "parameter_error" not in single.missed
    assert null.missed == ("false",)
    assert hidden.missed == ()
    assert single.top1 == pytest.approx(2 / 3)
    assert single.exact == pytest.approx(1 / 3)
    assert single.wrong == pytest.approx(2 / 3)
    assert single.parameter_error == pytest.approx(0.02)
    assert single.coverage == 1.0
    assert single.kind == 0.0  # called measurement, and something of the vehicle beside it
    assert single.set_size == pytest.approx(4 / 3)
    assert null.false == pytest.approx(2 / 3)  # an error is no clean bill
    assert null.errors == 1
    assert null.false_ci95 is not None
    assert null.false_ci95[0] < 0.5 < null.false_ci95[1]
    assert hidden.channel == 1.0
    assert hidden.wrong == 0.0


@pytest.mark.parametrize(("named", "code"), [(True, 0), (False, 5)])
def test_the_command_ends_as_its_goals_are_met(
    named: bool, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fake(case: Case) -> dict[str, Any]:
        found = list(case.answer) if named else []
        hidden = {"verdict": "unknown", "remainder": {"channel": case.channel}} if case.left_out else {}
        made = row(case.name, list(case.answer), [] if case.left_out else found, tier=case.tier, channel=case.channel,
                   oracle_share=1.0, **hidden)  # fmt: skip
        if case.number % 20 == 0:  # one interval in twenty misses
            made["truth"] = {e: dict.fromkeys(values, 1.5) for e, values in made["truth"].items()}
        return made

    monkeypatch.setattr(running, "run_case", fake)
    words = ["bcid", "prove", "--out", str(tmp_path), "--workers", "1", "--nulls", "2", "--imperfect-nulls", "2",
             "--pairs", "2", "--repeats", "1", "--format", "json"]  # fmt: skip
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr()
    assert (ended.value.code or 0) == code
    tier = {t["tier"]: t for t in json.loads(told.out)["tiers"]}
    assert tier["single"]["goal"]["top1"] == [0.95, 1.0]
    assert ("top1" in tier["single"]["missed"]) is not named
    assert ("goals missed" in told.err) is not named

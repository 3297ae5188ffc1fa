"""The blind test's own honesty: cases, the wall between answer and diagnosis, and the counting."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from docs_tables import evidence_table
from making import ThreadPool

from bcid.cli.app import main
from bcid.diagnosis.diagnose import Diagnosis, diagnose_recordings
from bcid.documents.prove import RightAnswers
from bcid.effects.table import EFFECTS
from bcid.errors import InputRefused, UsageError
from bcid.estimate.run import estimate_motion
from bcid.files.source_code import import_closure
from bcid.proof.blind import diagnose_case, run_cases
from bcid.proof.blind.baselines import METHODS, run_baselines
from bcid.proof.blind.blind_test import BlindTest, SuiteSizes, run_blind_test
from bcid.proof.blind.cases import EXACT_EQUIVALENTS, QUICK_STRIDES, BlindCase, draw_quick_suite, draw_suite
from bcid.proof.blind.concealed_effects import (
    MEASUREMENT_EFFECTS,
    MORE_OUTSIDE_EFFECTS,
    OUTSIDE_EFFECTS,
    SIZE_RANGES,
    ConcealedEffect,
    draw_outside_effect,
)
from bcid.proof.blind.run_cases import count_cases_with_rows, run_all_cases
from bcid.proof.blind.seal import answer_seal, open_seals, seal_over, write_seals
from bcid.proof.limits import GOALS, LIMITS
from bcid.proof.real import jobs
from bcid.proof.rows import append_row, read_rows
from bcid.proof.scores.calibration import calibration, null_p_values
from bcid.proof.scores.compare_methods import NAMING_METHODS, compare_methods
from bcid.proof.scores.localisation import circle_overlap, is_channel_right, place_overlap, time_overlap
from bcid.proof.scores.outcome import blind_outcome, describe_wrong_answer, missed_goals
from bcid.proof.scores.tiers import is_right, pool_right_answers, score_tiers
from bcid.recording.read import read_recording
from bcid.report.proof_page import write_proof_page
from bcid.vehicle import read_vehicle
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle


def test_every_effect_of_the_vocabulary_can_be_concealed() -> None:
    assert set(SIZE_RANGES) == set(EFFECTS)
    assert set(MEASUREMENT_EFFECTS) == {n for n, e in EFFECTS.items() if e.kind == "measurement"}
    for name, range_of_sizes in SIZE_RANGES.items():
        assert range_of_sizes.low <= EFFECTS[name].parameters[0].size <= range_of_sizes.high, name


def test_a_suite_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    one, same, other = (list(draw_suite(seed, 1, 2, 2, 2)) for seed in (1, 1, 2))
    assert one == same
    assert one != other
    assert len({c.name for c in one}) == len(one)
    for case in one:
        for concealed in (c for c in case.concealed if c.effect in EFFECTS):
            assert set(concealed.parameters) == {p.symbol for p in EFFECTS[concealed.effect].parameters}


def test_the_answer_changes_nothing_that_the_diagnosis_is_handed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is held beside what was said afterwards."""
    case = next(c for c in draw_suite(1, 1, 0, 0, 0) if c.answer == ("yaw_scrub",))
    handed = list[Any]()

    def diagnosed(*given: Any, **more: Any) -> None:
        handed.append((given, more))
        raise ArithmeticError("asked")

    monkeypatch.setattr(diagnose_case, "diagnose_recordings", diagnosed)
    for truth in (case.nameable_effects, {"rear_toe": {"epsilon": 0.3}}):
        with pytest.raises(ArithmeticError, match="asked"):
            diagnose_case.diagnose_concealed_drive(
                replace(case, duration_s=20.0).simulate(), case.rate_hz, ("motor_lag",), truth
            )
    one, _ = handed
    assert [type(v).__name__ for v in one[0]] == ["list", "list", "Vehicle"]
    assert [[type(v).__name__ for v in of] for of in one[0][:2]] == [["Recording"], ["Estimate"]]
    assert one[1] == {"excluded": ("motor_lag",), "reference": None}
    leaves = [_leaves([asdict(of[0][0][0]), asdict(of[0][1][0]), of[0][2].model_dump(), of[1]]) for of in handed]
    assert len(leaves[0]) == len(leaves[1]) > 10
    for a, b in zip(*leaves, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_diagnosis_is_handed_no_answer() -> None:
    case = next(c for c in draw_suite(1, 1, 0, 0, 0) if c.answer == ("yaw_scrub",))
    recording = record_drive(case.simulate(), case.rate_hz, simulated_vehicle(), "concealed")
    words = [v for v in _leaves(asdict(recording)) if isinstance(v, str)]
    assert "concealed" in words
    assert not [w for w in words if "yaw" in w or "scrub" in w or "single" in w]
    numbers = [np.ravel(v) for v in _leaves(asdict(recording)) if isinstance(v, int | float | np.ndarray)]
    assert max(map(len, numbers)) > 1000  # the streams are among them
    assert not np.isin(case.concealed[0].parameters["c"], np.concatenate(numbers))


def _leaves(tree: Any) -> list[Any]:
    if isinstance(tree, dict):
        return [leaf for value in tree.values() for leaf in _leaves(value)]
    if isinstance(tree, list | tuple):
        return [leaf for value in tree for leaf in _leaves(value)]
    return [tree]


def known(cases: list[BlindCase], folder: Path) -> int:
    """How many cases' rows lie in `folder`, by today's code."""
    rows, code = read_rows(folder), run_cases.case_code_digest(False)
    found = [rows.get(run_cases._row_key(case, code), {"error": "none"}) for case in cases]
    return sum("error" not in row for row in found)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of cases as they are run, the first of seed 1 in vain."""
    names: list[str] = []

    def fake(case: BlindCase, others: bool = False) -> dict[str, Any]:
        names.append(case.name)
        if case.seed == 1 and len(names) == 1:
            raise ValueError("no such luck")
        return {name: value for name, value in row(case.name, [], []).items() if name != "case"}

    monkeypatch.setattr(run_cases, "run_blind_case", fake)
    return names


def test_rows_are_kept_by_case_and_made_again_after_an_error(tmp_path: Path, made: list[str]) -> None:
    cases = list(draw_suite(1, 1, 2, 0, 0))[:3]
    assert sum("error" in r for r in run_all_cases(cases, tmp_path, 1)) == 1
    assert not any("error" in r for r in run_all_cases(cases, tmp_path, 1))
    assert len(made) == 4
    assert {r["case"] for r in read_rows(tmp_path).values()} == {c.name for c in cases}
    others = list(draw_suite(2, 1, 2, 0, 0))[:3]
    list(run_all_cases(others, tmp_path, 1))
    assert len(made) == 7  # another seed's cases of the same names are others
    assert known(cases + others, tmp_path) == 6
    file = tmp_path / "rows.jsonl"
    file.write_bytes(file.read_bytes()[:-20])  # a run was cut off as it wrote
    more = list(draw_suite(3, 1, 2, 0, 0))[:1]
    assert {r["case"] for r in run_all_cases(cases + others + more, tmp_path, 1)} == {c.name for c in cases}
    assert len(made) == 9  # the row that was not whole, and the new one
    assert known(cases + others + more, tmp_path) == 7


def test_a_run_ends_in_time_and_goes_on(tmp_path: Path, made: list[str]) -> None:
    """By lot: the part that was run first is of no tier more than of another."""
    cases = list(takewhile(lambda case: case.tier != "half-size", draw_suite(2, 1, 40, 0, 0)))  # some 200
    assert list(run_all_cases(cases, tmp_path, 1, minutes=0.0)) == []
    first = [r["case"] for r in islice(run_all_cases(cases, tmp_path, 1), 60)]
    assert 4 < sum(name.startswith("null") for name in first) < 24
    assert len(list(run_all_cases(cases, tmp_path, 1, minutes=0.0))) == len(made) == 60
    assert {r["case"] for r in run_all_cases(cases, tmp_path, 1)} == {c.name for c in cases}
    assert len(made) == len(cases)


def test_several_at_a_time_end_in_time_and_go_on(
    tmp_path: Path, made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bcid.execution.jobs.make_pool", ThreadPool)  # which shares what stands in for a diagnosis
    cases = list(takewhile(lambda case: case.tier != "half-size", draw_suite(2, 1, 4, 0, 0)))[-20:]
    assert list(run_all_cases(cases, tmp_path, 3, minutes=0.0)) == []
    first = [r["case"] for r in islice(run_all_cases(cases, tmp_path, 3), 5)]
    assert 5 <= len(made) <= 8  # what has begun is ended
    assert {r["case"] for r in run_all_cases(cases, tmp_path, 3)} == {c.name for c in cases} > set(first)
    assert sorted(made) == sorted(c.name for c in cases)


def test_rows_made_on_a_cluster_are_stored_here(tmp_path: Path, made: list[str]) -> None:
    cases = list(draw_suite(2, 1, 2, 0, 0))[:3]
    assert len(list(run_all_cases(cases, tmp_path, ThreadPool(2)))) == len(made) == 3
    assert known(cases, tmp_path) == 3
    assert len((tmp_path / "rows.jsonl").read_text(encoding="utf-8").splitlines()) == 3


def test_a_part_of_a_run_is_told_as_one() -> None:
    about = {"seed": 1, "quick": False, "of": 9, "tiers_of": {"null": 5, "pair": 4}}
    part = blind_outcome([row(f"null-{i}", [], ["yaw_scrub"] * i, tier="null") for i in range(2)], about)
    assert "| nothing | 2 of 5 |" in evidence_table(part)
    assert "| two effects | 0 of 4 | not run |" in evidence_table(part)
    assert list(part.missed) == missed_goals(part) == []  # one of two may be chance
    assert missed_goals(part.model_copy(update={"of": 2, "tiers_of": {"null": 2}})) == ["null: false"]


def test_a_tier_that_has_ended_is_judged_by_its_goals_though_others_have_not() -> None:
    rows = [row(f"null-{i}", [], ["yaw_scrub"] * (i == 0), tier="null") for i in range(20)]
    rows += [row(f"triple-{20 + i}", ["yaw_scrub"], [said], tier="triple") for i, said in enumerate(THIS_AND_THAT)]
    about = {"seed": 1, "quick": False, "of": 30, "tiers_of": {"null": 20, "triple": 10}}
    assert blind_outcome(rows, about).missed == ("null: false",)  # one in twenty, where one in a hundred is wanted
    wrong = [row(f"triple-{30 + i}", ["yaw_scrub"], ["rear_toe"], tier="triple") for i in range(4)]
    assert blind_outcome([*rows, *wrong], about).missed == (
        "null: false", "all: 20 of 26 right where 25.2 are wanted", "triple: 1 of 6 right where 5.4 are wanted",
    )  # fmt: skip


def test_rows_outlive_what_is_concealed_and_how_it_is_scored() -> None:
    """What makes a row is the code of simulation and diagnosis: neither suites, nor scores, nor other methods."""
    reached = import_closure(run_cases.ROW_MODULES)
    own = {name for name in reached if name.startswith("bcid.proof.")}
    assert own == {"bcid.proof.blind", "bcid.proof.blind.diagnose_case", "bcid.proof.rows"}
    assert {"bcid.simulation.dynamics", "bcid.diagnosis.search.name_search", "bcid.effects.car"} <= reached
    others = import_closure(("bcid.proof.blind.baselines",))
    assert not others & {"bcid.proof.limits", "bcid.proof.scores.tiers"}
    reached = import_closure(jobs.ROW_MODULES)
    own = {name.removeprefix("bcid.proof.") for name in reached if name.startswith("bcid.proof.")}
    not_of_rows = {"jobs", "run_questions", "scoring", "figures"}
    modules = {path.stem for path in Path(jobs.__file__).parent.glob("[!_]*.py")} - not_of_rows
    assert own == {"rows", "blind", "blind.regressors", "real", *(f"real.{name}" for name in modules)}
    assert not [name for name in reached if name.startswith("bcid.simulation")]


THIS_AND_THAT = ("yaw_scrub", "rear_toe")


def row(case: str, answer: list[str], found: list[str], **more: Any) -> dict[str, Any]:
    findings = [
        {"effect": e, "kind": EFFECTS[e].kind, "twins": [], "probability": 1.0, "gain": 100.0, "heldout": 90.0,
         "values": {EFFECTS[e].parameters[0].symbol: [1.02, 0.02]}}
        for e in found
    ]  # fmt: skip
    truth = {e: {EFFECTS[e].parameters[0].symbol: 1.0} if e in EFFECTS else {} for e in answer}
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
    single, null, hidden = score_tiers(rows)
    assert {"right", "top1", "set", "kind"} <= set(single.missed)
    assert single.right == pytest.approx(1 / 3)
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


def test_what_a_recording_does_not_show_is_not_to_be_named() -> None:
    """A slippery patch, driven over by a car whose tyres never slide: even the truth is worth nothing there."""
    patch = ["slippery_patch"]
    told, untold, named = (
        row(f"closed-loop-{i}", patch, found, tier="closed-loop", shown=False, not_excited=unseen)
        for i, found, unseen in ((1, [], {"slippery_patch": 0.9}), (2, [], {}), (3, patch, {"slippery_patch": 0.9}))
    )
    assert [is_right(r) for r in (told, untold, named)] == [True, False, False]
    there = row("closed-loop-4", patch, patch, tier="closed-loop", shown=True)
    (tier,) = score_tiers([told, untold, named, there])
    assert (tier.top1, tier.not_seen, tier.unshown) == (1.0, pytest.approx(1 / 3), 0.75)
    singles = [row(f"single-{i}", patch, [], shown=False) for i in range(20)]  # an effect that nothing could name
    assert "unshown" in score_tiers(singles)[0].missed
    assert is_right(there)
    assert describe_wrong_answer(untold).as_json() == {
        "case": "closed-loop-2",
        "there": "slippery_patch",
        "said": "nothing-found",
    }
    assert describe_wrong_answer({**untold, "error": "ValueError()"}).said == "ValueError()"


HIDING = ("left-out", "outside", "small-outside")
SILENT = ("null", "null-imperfect", "small-null", "other-laws", "other-day")


def twenty(tier: str, named: list[str], **more: Any) -> list[dict[str, Any]]:
    """Takes of a tier that are all answered alike."""
    answer = [] if tier in SILENT else ["yaw_scrub"]
    hidden = {"channel": "mz", "remainder": {"channel": "mz"}} if tier in HIDING else {}
    return [row(f"{tier}-{i}", answer, named, tier=tier, oracle_share=1.0, **hidden, **more) for i in range(20)]


@pytest.mark.parametrize("tier", list(GOALS))
@pytest.mark.parametrize("named", [[], ["yaw_scrub"], ["yaw_scrub", "rear_toe"], ["rear_toe"]])
def test_no_tier_s_goals_are_met_by_saying_nothing_or_too_much(tier: str, named: list[str]) -> None:
    silent, hidden = tier in SILENT, tier in (*HIDING, "unexcited")
    right = not hidden and named == ([] if silent else ["yaw_scrub"])
    missed = set(score_tiers(twenty(tier, named))[0].missed) - {
        "coverage"
    }  # all intervals hold here, which is too good
    assert (missed == set()) is right


@pytest.mark.parametrize("tier", ["single", "single-imperfect"])
def test_what_a_drive_shows_may_not_be_told_as_not_excited(tier: str) -> None:
    (told,) = score_tiers(twenty(tier, ["yaw_scrub"], not_excited=dict.fromkeys(EFFECTS)))
    assert (told.right, told.denied) == (1.0, 1.0)
    assert "denied" in told.missed


@pytest.mark.parametrize(("named", "code"), [(True, 0), (False, 5)])
def test_the_command_ends_as_its_goals_are_met(
    named: bool, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fake(case: BlindCase, others: bool = False) -> dict[str, Any]:
        found = list(case.answer) if named else []
        unseen = case.answer if named and case.tier == "unexcited" else ()
        hidden = {"verdict": "unknown", "remainder": {"channel": case.channel}} if case.channel else {}
        silent = case.channel or case.tier == "unexcited"
        made = row(case.name, list(case.answer), [] if silent else found, tier=case.tier, channel=case.channel,
                   oracle_share=1.0, not_excited=dict.fromkeys(unseen), **hidden)  # fmt: skip
        if case.number % 20 == 0:  # one interval in twenty misses
            made["truth"] = {e: dict.fromkeys(values, 1.5) for e, values in made["truth"].items()}
        return made

    monkeypatch.setattr(run_cases, "run_blind_case", fake)
    words = ["bcid", "prove", "--out", str(tmp_path), "--workers", "1", "--nulls", "2", "--imperfect-nulls", "2",
             "--pairs", "2", "--repeats", "1", "--format", "json"]  # fmt: skip
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr()
    assert (ended.value.code or 0) == code
    tier = {t["tier"]: t for t in json.loads(told.out)["tiers"]}
    assert tier["single"]["goal"]["top1"] == [0.98, 1.0]
    assert ("top1" in tier["single"]["missed"]) is not named
    assert ("goals missed" in told.err) is not named


def test_a_case_that_kills_its_processes_is_a_miss_and_ends_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = BlindTest(quick=True).cases[:3]

    def fake(case: BlindCase, others: bool = False) -> dict[str, Any]:
        return row(case.name, list(case.answer), [], tier=case.tier, channel=case.channel)

    def run(jobs: Any, prepare: Any, workers: Any, lost: Any) -> Any:
        for number, case in enumerate(jobs):
            yield case, lost(case) if number == 1 else prepare(case)()

    monkeypatch.setattr(run_cases, "run_blind_case", fake)
    monkeypatch.setattr(run_cases, "run_jobs", run)
    # what was lost is run again by the next run
    for errors in ([False, False, True], [False, False, False]):
        rows = list(run_all_cases(cases, tmp_path, 2))
        assert sorted("error" in row for row in rows) == errors
        assert all(row["tier"] for row in rows)


def test_answers_are_sealed_before_the_first_take_and_opened_after_the_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = list[tuple[bool, bool]]()

    def fake(case: BlindCase, others: bool = False) -> dict[str, Any]:
        seen.append(((tmp_path / "seals.json").is_file(), (tmp_path / "answers.json").is_file()))
        return row(case.name, list(case.answer), [], tier=case.tier, channel=case.channel)

    monkeypatch.setattr(run_cases, "run_blind_case", fake)
    words = ["bcid", "prove", "--out", str(tmp_path), "--workers", "1", "--every", "40", "--format", "quiet",
             "--salt", "pepper"]  # fmt: skip
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) as refused:
        main()
    assert refused.value.code == 2
    assert "default seed" in capsys.readouterr().err
    assert not (tmp_path / "seals.json").exists()
    monkeypatch.setattr("sys.argv", [*words, "--seed", "7"])
    with pytest.raises(SystemExit):
        main()
    assert len(seen) > 10
    assert set(seen) == {(True, False)}
    told = json.loads((tmp_path / "prove.json").read_text(encoding="utf-8"))
    assert (told["opened"], told["known_before"], told["made_after_opening"]) == (len(seen), 0, 0)
    assert told["seal"] in capsys.readouterr().err


def test_a_case_s_recording_is_written_for_whoever_wants_to_look_at_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is what was asked, but for the file's own rounding."""
    case = next(c for c in draw_suite(7, 3, 300, 100, 50) if c.tier == "two-minutes")
    words = ["bcid", "prove", "--out", str(tmp_path), "--seed", "7", "--case"]
    monkeypatch.setattr("sys.argv", [*words, "no-such-0001"])
    with pytest.raises(SystemExit) as refused:
        main()
    assert refused.value.code == 2
    assert "no such case" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", [*words, case.name])
    with suppress(SystemExit):
        main()
    path = tmp_path / f"{case.name}.mcap"
    assert capsys.readouterr().out.strip() == str(path)
    of = read_vehicle(tmp_path / "bumper_car.toml")
    read, asked = read_recording(path, of), record_drive(case.simulate(), case.rate_hz, simulated_vehicle())
    np.testing.assert_allclose(read.poses.values, asked.poses.values, atol=1e-6)
    assert json.loads((tmp_path / f"{case.name}.answer.json").read_text())["effects"].keys() == set(case.answer)


@pytest.mark.parametrize("more", [["--salt", "s"], ["--minutes", "1"], ["--baselines"]])
def test_a_case_is_only_written(
    more: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bcid", "prove", "--out", str(tmp_path), "--seed", "7", "--case", "null-0001"]
    monkeypatch.setattr("sys.argv", [*words, *more])
    with pytest.raises(SystemExit) as refused:
        main()
    assert refused.value.code == 2
    assert "only writes" in capsys.readouterr().err


def test_what_was_not_made_after_an_opening_does_not_count_as_such(tmp_path: Path, made: list[str]) -> None:
    """An error that there is no time to ask again is told once more, and not made."""
    test = BlindTest(seed=1, salt="pepper", sizes=SuiteSizes(1, 2, 0, 0, 60))
    told = [run_blind_test(test, tmp_path, minutes=minutes) for minutes in (None, 0.0, None, None)]
    assert [t.made_after_opening for t in told] == [0, 0, 1, 1]
    assert [sum(tier.errors for tier in t.tiers) for t in told] == [1, 1, 0, 0]
    assert {t.cases for t in told} == {len(test.cases)}


def test_a_page_is_written_of_nothing_but_errors(tmp_path: Path) -> None:
    """When it is wanted most."""
    broken = [{"case": "null-1", "tier": "null", "answer": [], "channel": "", "error": "ValueError()"}]
    found = blind_outcome(broken, {"seed": 1, "salt": "", "seal": None, "quick": True, "code": "c0de"})
    write_proof_page(found, tmp_path / "p.html")
    assert "ValueError" in (tmp_path / "p.html").read_text(encoding="utf-8")


def test_what_older_code_said_was_known_before(tmp_path: Path) -> None:
    cases = list(draw_suite(7, 1, 2, 0, 0))[:3]
    append_row(row(cases[1].name, [], []), f"{cases[1].digest()}.of_older_code", tmp_path)
    assert (known(cases, tmp_path), count_cases_with_rows(cases, tmp_path)) == (0, 1)


def test_an_error_that_there_is_no_time_to_ask_again_counts(tmp_path: Path, made: list[str]) -> None:
    cases = list(draw_suite(1, 1, 2, 0, 0))[:3]
    first = list(run_all_cases(cases, tmp_path, 1))
    again = list(run_all_cases(cases, tmp_path, 1, minutes=0.0))
    assert sorted(r["case"] for r in again) == sorted(r["case"] for r in first)
    assert sum("error" in r for r in again) == 1
    assert len(made) == 3


def test_a_seal_fits_its_answer_and_salt_alone() -> None:
    one, other = list(draw_suite(1, 1, 1, 0, 0))[:2]
    assert answer_seal(one, "salt") == answer_seal(one, "salt")
    assert len({answer_seal(one, "salt"), answer_seal(one, "pepper"), answer_seal(other, "salt")}) == 3
    told = one.concealed[0]
    key = next(iter(told.parameters))

    def first_parameter_larger_by(share: float) -> BlindCase:
        changed = {**told.parameters, key: told.parameters[key] * (1.0 + share)}
        return replace(one, concealed=(replace(told, parameters=changed),))

    # as another processor may draw it
    assert answer_seal(first_parameter_larger_by(3e-16), "salt") == answer_seal(one, "salt")
    for changed in (first_parameter_larger_by(1e-7), replace(one, channel="fx"), replace(one, tier="null")):
        assert answer_seal(changed, "salt") != answer_seal(one, "salt")
    seals = [answer_seal(case, "salt") for case in (one, other)]
    assert seal_over(seals) != seal_over(seals[::-1])


def test_seals_lie_there_before_and_are_opened_after(tmp_path: Path) -> None:
    cases = list(draw_suite(1, 1, 1, 0, 0))[:3]
    seal = write_seals(cases, "salt", tmp_path, 1)
    kept = json.loads((tmp_path / "seals.json").read_text(encoding="utf-8"))
    assert kept["cases"] == {c.name: answer_seal(c, "salt") for c in cases}
    assert not any(c.answer[0] in (tmp_path / "seals.json").read_text(encoding="utf-8") for c in cases)
    assert write_seals(cases, "salt", tmp_path, 3) == seal  # a run that goes on
    with pytest.raises(UsageError, match="seals of other answers"):
        write_seals(cases, "pepper", tmp_path, 0)
    assert open_seals(cases[:2], "salt", tmp_path, 2) == {"opened": 2, "known_before": 1, "made_after_opening": 0}
    assert cases[2].answer[0] not in (tmp_path / "answers.json").read_text(encoding="utf-8")
    assert open_seals(cases, "salt", tmp_path, 1) == {"opened": 3, "known_before": 1, "made_after_opening": 1}
    kept = json.loads((tmp_path / "seals.json").read_text(encoding="utf-8"))
    told = json.loads((tmp_path / "answers.json").read_text(encoding="utf-8"))
    assert [list(a["effects"]) for a in told["answers"]] == [list(c.answer) for c in cases]
    kept["cases"][cases[1].name] = "0" * 64
    (tmp_path / "seals.json").write_text(json.dumps(kept), encoding="utf-8")
    with pytest.raises(InputRefused, match="does not fit the answer"):
        open_seals(cases, "salt", tmp_path)


EXPLAINING = ("bcid.diagnosis.diagnose", "bcid.estimate.run", "bcid.recording.assemble")
THE_SIMULATION = ("bcid.simulation.drive", "bcid.simulation.dynamics", "bcid.simulation.samples")


@pytest.mark.parametrize(
    ("roots", "among", "never"),
    [
        (EXPLAINING, "bcid.diagnosis.search.name_search", ("bcid.proof", "bcid.simulation")),
        (THE_SIMULATION, "bcid.simulation.car", ("bcid.proof", "bcid.diagnosis", "bcid.likelihood", "bcid.effects",
                                                 "bcid.models", "bcid.physics", "bcid.estimate")),
    ],
)  # fmt: skip
def test_truth_and_judge_are_apart(roots: tuple[str, ...], among: str, never: tuple[str, ...]) -> None:
    """Nothing that a diagnosis runs imports the blind test or the simulation, nor does that import what explains it."""
    reached = import_closure(roots)
    assert among in reached
    assert not [name for name in reached if name.startswith(never)]


@pytest.mark.parametrize("name", [*OUTSIDE_EFFECTS, *MORE_OUTSIDE_EFFECTS])
def test_what_has_no_name_lives_in_the_simulation_alone(name: str) -> None:
    """It changes the drive at its size, and nothing at zero; no entry of the vocabulary knows it."""
    assert name not in EFFECTS
    _, size = (OUTSIDE_EFFECTS | MORE_OUTSIDE_EFFECTS)[name]
    given = BlindCase("usual", 0, (), duration_s=60.0)
    hidden = draw_outside_effect(name, np.random.default_rng(1))
    assert size.low <= abs({**hidden.plant, **hidden.sensor}[name]) <= size.high
    still = replace(
        given,
        concealed=(
            ConcealedEffect(name, {k: 0.0 for k in hidden.plant if k == name}, dict.fromkeys(hidden.sensor, 0.0)),
        ),
    )
    np.testing.assert_array_equal(still.simulate().pose, given.simulate().pose)
    moved = replace(given, concealed=(hidden,)).simulate().pose - given.simulate().pose
    assert np.nanmax(np.abs(moved)) > 8e-4


def test_all_that_is_asked_for_is_in_the_suite() -> None:
    whole = list(draw_suite(1, 1, 2, 2, 5, 1, 1))
    tiers_there = {c.tier for c in whole}
    assert {
        "null", "null-imperfect", "single", "half-size", "double-size", "pair", "triple", "measurement-and-vehicle",
        "outside", "unexcited", "closed-loop", "two-minutes", "thirty-minutes", "ten-hertz", "hundred-twenty-hertz",
        "small-exact", "small-plus", "small-null", "small-wrong", "small-outside",
        "other-laws", "other-laws-less", "other-day", "other-day-less",
    } <= tiers_there  # fmt: skip
    assert {c.answer[0] for c in whole if c.tier == "single"} == set(EFFECTS)
    assert len({c.answer[0] for c in whole if c.tier == "outside"}) >= 12
    assert all(
        set(EXACT_EQUIVALENTS["pose_latency"]) <= set(c.left_out)
        for c in whole
        if "pose_latency" in c.answer and c.left_out
    )
    drawn = [draw_quick_suite(list(draw_suite(seed, 3, 300, 100, 50)), seed) for seed in (1, 1, 2, 3)]
    assert drawn[0] == drawn[1]
    for few in drawn:
        assert 15 <= len(few) <= 25
        assert [c.tier for c in few if c.tier.startswith("small")] == ["small-exact", "small-wrong"]
        assert {c.tier for c in few} == set(QUICK_STRIDES) <= set(GOALS)
        for tier in ("single", "single-imperfect", "left-out"):
            answers = [c.answer for c in few if c.tier == tier]
            assert len(set(answers)) == len(answers)
    for tier in ("single", "left-out", "outside", "closed-loop"):  # who knows one run's names does not know the next's
        assert len({tuple(c.answer for c in few if c.tier == tier) for few in drawn[1:]}) == 3


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
def test_workers_end_with_who_started_them() -> None:
    """A run that is killed leaves none behind that would keep the cores busy for what nobody reads."""
    begin = "import os, time; from functools import partial; from bcid.execution.pool import WorkerPool; "
    work = (
        "pool = WorkerPool(1); pool.submit(0, os.getpid); print(pool.next_results()[0][1], flush=True); "
        "pool.submit(1, partial(time.sleep, 600)); time.sleep(600)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", begin + work], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as run:
        assert run.stdout is not None
        worker = int(run.stdout.readline())
        assert _lives(worker)
        run.kill()
    until = time.monotonic() + 30.0
    while time.monotonic() < until and _lives(worker):
        time.sleep(0.1)
    assert not _lives(worker)


def _lives(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_circles_overlap() -> None:
    assert circle_overlap((0, 0, 1), (0, 0, 1)) == pytest.approx(1.0)
    assert circle_overlap((0, 0, 1), (3, 0, 1)) == 0.0
    assert circle_overlap((0, 0, 1), (0.2, 0, 0.5)) == pytest.approx(0.25)
    # by counting points
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (200_000, 2))
    a, b = np.hypot(*points.T) < 1.0, np.hypot(*(points - [0.7, 0.3]).T) < 0.8
    assert circle_overlap((0, 0, 1), (0.7, 0.3, 0.8)) == pytest.approx((a & b).sum() / (a | b).sum(), abs=0.01)


def test_where_is_scored() -> None:
    patch = {"b": 20.0, "x": 1.0, "y": 0.0, "radius": 1.0}
    hit = row("a-1", ["rough_patch"], ["rough_patch"], located="fx", duration_s=600.0) | {
        "truth": {"rough_patch": patch}
    }
    hit["findings"][0]["values"] = {k: [v, 0.0] for k, v in patch.items()}
    assert place_overlap(hit) == pytest.approx(1.0)
    assert is_channel_right(hit) is True
    missed = hit | {"findings": [], "place": None, "located": "fy"}
    assert place_overlap(missed) == 0.0
    assert is_channel_right(missed) is False
    heavier = row("a-2", ["mass_change"], [], window=[400.0, 600.0], duration_s=600.0, located="fx") | {
        "truth": {"mass_change": {"d": 0.1, "t_s": 300.0}}
    }
    assert time_overlap(heavier) == pytest.approx(200.0 / 300.0)
    assert is_channel_right(heavier) is None  # it acts on all
    beside = hit["remainder"] | {"nats": 12.0}
    (tier,) = score_tiers([hit, missed, row("a-3", ["yaw_scrub"], ["yaw_scrub"], located="mz", remainder=beside)])
    assert tier.place_overlap == 0.5
    assert tier.more == 0.5  # of two right names
    assert tier.located == pytest.approx(2 / 3)


def test_stated_probabilities_are_counted() -> None:
    rows = [row(f"s-{i}", ["yaw_scrub"], ["yaw_scrub" if i < 9 else "rear_toe"]) for i in range(10)]
    for r in rows:
        r["findings"][0]["probability"] = 0.9
    found = calibration(rows)
    assert found.n == 10
    assert found.brier == pytest.approx(0.09 * 0.1 + 0.9 * 0.01 + 0.072, abs=0.01)
    (only,) = found.bins
    assert (only.stated, only.there) == (pytest.approx(0.9), pytest.approx(0.9))
    assert only.there_ci95 == pytest.approx((0.555, 0.9975), abs=1e-3)  # Clopper and Pearson's table
    nothing = [row(f"null-{i}", [], [], tier="null", p_value=p) for i, p in enumerate((0.01, 0.2, 0.5, 1.0))]
    told = null_p_values([*rows, *nothing])
    assert told is not None
    assert (told.n, told.share) == (4, 0.25)
    assert null_p_values(rows) is None


def test_few_cases_of_many_tiers_are_judged_together() -> None:
    def found(wrong: int) -> RightAnswers:
        rows = [row(f"single-{i}", ["yaw_scrub"], ["rear_toe" if i < wrong else "yaw_scrub"]) for i in range(12)]
        rows += [row(f"null-{i}", [], [], tier="null") for i in range(4)]
        return pool_right_answers(rows)

    # a tier that is broken altogether hides among the others, and is missed all the same
    blind = [row(f"single-{i}", ["yaw_scrub"], ["yaw_scrub"]) for i in range(18)]
    blind += [row(f"null-{i}", [], ["rear_toe"], tier="null") for i in range(2)]
    said = blind_outcome(blind, {"quick": True})
    assert said.pooled.p > LIMITS.refuting_p
    assert missed_goals(said) == ["null: 0 of 2 right where 2.0 are wanted"]
    assert found(0).right == found(0).n == 16
    assert found(1).p > LIMITS.refuting_p  # one of sixteen: chance
    assert found(5).p < LIMITS.refuting_p
    # by drawing: twelve at 0.95 and four at 0.99
    draws = np.random.default_rng(0).random((200_000, 16)) < np.r_[np.full(12, 0.95), np.full(4, 0.99)]
    assert found(2).p == pytest.approx((draws.sum(axis=1) <= 14).mean(), abs=0.005)


def test_what_is_right() -> None:
    assert is_right(row("a-1", ["yaw_scrub"], ["yaw_scrub"]))
    assert not is_right(row("a-1", ["yaw_scrub"], ["yaw_scrub", "rear_toe"]))
    for twins, told in (["rear_toe", "yaw_coulomb", "motor_sag"], True), (["a", "b", "c", "d"], False):
        ambiguous = row("a-1", ["yaw_scrub"], ["yaw_scrub"])
        ambiguous["findings"][0]["twins"] = twins
        assert is_right(ambiguous) is told  # a set that is too long tells nothing, here as in its tier's figures
        assert score_tiers([ambiguous])[0].set == float(told)
    assert not is_right(row("a-1", ["yaw_scrub"], []))
    assert is_right(row("a-1", [], [], tier="null"))
    assert not is_right(row("a-1", [], [], tier="null", verdict="unknown"))  # something missing where nothing is
    assert is_right(row("a-1", [], [], tier="null-imperfect", verdict="unknown"))
    hidden = row(
        "a-1", ["yaw_scrub"], [], tier="left-out", channel="mz", verdict="unknown", remainder={"channel": "mz"}
    )
    assert is_right(hidden)
    assert not is_right(hidden | {"remainder": {"channel": "fx"}})
    assert not is_right(row("a-1", ["yaw_scrub"], ["yaw_scrub"]) | {"error": "ValueError()"})


def test_the_page_and_the_table_show_what_is_missed(tmp_path: Path) -> None:
    rows = [row("single-1", ["yaw_scrub"], ["rear_toe"]), row("null-2", [], [], tier="null")]
    found = blind_outcome(rows, {"seed": 1, "salt": "<s>", "seal": "abc", "quick": False, "code": "c0de"})
    assert found.confusion == {"yaw_scrub": {"rear_toe": 1}, "nothing": {"nothing": 1}}
    text = evidence_table(found)
    assert "| one effect | 1 | **0\N{NO-BREAK SPACE}%** missed (≥\N{NO-BREAK SPACE}95\N{NO-BREAK SPACE}%) |" in text
    assert "| nothing | 1 | 100\N{NO-BREAK SPACE}% | – |" in text
    write_proof_page(found, tmp_path / "p.html")
    page = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert "0\N{NO-BREAK SPACE}% missed (≥\N{NO-BREAK SPACE}95\N{NO-BREAK SPACE}%)" in page
    assert "&lt;s&gt;" in page
    assert "default-src 'none'" in page
    assert page.count("<svg ") == 2  # what was taken for what, and whether probabilities hold


@pytest.mark.parametrize("o", [0.012, -0.012])
def test_other_methods_say_what_they_can(o: float) -> None:
    """A steering offset of either sign is named by the stepwise method; what fits only, names nothing."""
    found = _diagnosis(
        BlindCase("single", 5, (ConcealedEffect("steering_offset", {"steering_offset": o}),), duration_s=60.0)
    )
    said = run_baselines(found)
    assert set(said) == set(METHODS)
    assert said["stepwise BIC, base not refitted"]["effect"] in ("steering_offset", "body_yaw_misalignment")
    assert [m for m in METHODS if said[m]["effect"]] == [
        m for m in METHODS if m in NAMING_METHODS and said[m]["effect"]
    ]
    assert json.loads(json.dumps(said)) == said
    counted = {m.method: m for m in compare_methods([{**row("s-1", ["steering_offset"], []), "others": said}])}
    assert counted["bcid diagnose"].top1 == (0, 1)
    assert counted["residual MLP"].top1 is None


def test_a_take_on_which_the_diagnosis_ends_in_an_error_counts_against_it() -> None:
    """Nothing of the others is known there."""
    there, nothing = row("s-1", ["yaw_scrub"], ["yaw_scrub"]), row("n-2", [], [], tier="null")
    broken = {"case": "s-3", "tier": "single", "answer": ["yaw_scrub"], "channel": "", "error": "ValueError()"}
    net = {"effect": None, "detected": True, "explained": 0.7, "failed": "", "seconds": 1.0}
    ours, other = compare_methods([*({**r, "others": {"residual MLP": net}} for r in (there, nothing)), broken])
    assert (ours.method, ours.n, ours.failed, ours.seconds) == ("bcid diagnose", 3, 1, 1.0)
    assert (ours.top1, ours.detected, ours.false) == ((1, 2), (1, 2), (0, 1))
    assert (other.n, other.top1, other.detected, other.false) == (2, None, (1, 1), (1, 1))


def _diagnosis(case: BlindCase) -> Diagnosis:
    recording = record_drive(case.simulate(), case.rate_hz, simulated_vehicle())
    return diagnose_recordings(
        [recording], [estimate_motion(recording, simulated_vehicle(), TUNING)], simulated_vehicle()
    )

"""Limits halved and doubled: a changed limit is put back, verdicts are kept and compared, and `bcid prove --limits`."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from making import ThreadPool

import bcid
from bcid.cli import show
from bcid.cli.app import main
from bcid.diagnosis.kept_steps import READ_LIMITS, kept_under
from bcid.diagnosis.limits import DECIDING_LIMITS, JUDGE_LIMITS, SEARCH_LIMITS, limit_set_to
from bcid.documents.varied_limits import VariedLimitsDocument
from bcid.errors import InputRefused
from bcid.files.source_code import import_closure
from bcid.likelihood.kept_fits import KeptFits, content_key, kept_in_proofs, use_kept_fits
from bcid.proof.blind import vary_limits as runs
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.blind_test import BlindTest
from bcid.proof.blind.cases import draw_suite
from bcid.proof.blind.limit_panel import EXAMPLE, PANEL, draw_panel
from bcid.proof.blind.varied_take import (
    AS_THEY_ARE,
    Variation,
    VariedTake,
    list_variations,
    tell_variations,
    told_verdict,
)
from bcid.proof.rows import read_rows
from bcid.proof.scores.limit_changes import VariedRow, count_changes
from bcid.simulation.drive import simulate_drive
from bcid.simulation.samples import TAKES

NAMED = {"verdict": "named", "names": ["yaw_scrub"], "channel": ""}
UNKNOWN = {"verdict": "unknown", "names": [], "channel": "mz"}


# the limits


def test_a_dozen_limits_decide_at_most_and_each_is_one_of_its_class() -> None:
    assert 0 < len(DECIDING_LIMITS) <= 12
    for name, limits in DECIDING_LIMITS.items():
        assert name in vars(limits), name
        assert limits in (SEARCH_LIMITS, JUDGE_LIMITS), name
    method = (Path(__file__).parent.parent / "docs" / "method.md").read_text(encoding="utf-8")
    assert [name for name in DECIDING_LIMITS if f"`{name}`" not in method] == []


def test_a_limit_is_changed_for_a_block_and_put_back_whatever_is_raised() -> None:
    with limit_set_to("rival_nats", 8.0):
        assert JUDGE_LIMITS.rival_nats == 8.0
        with limit_set_to("rival_nats", 2.0), limit_set_to("near_nats", 1.0):
            assert (JUDGE_LIMITS.rival_nats, SEARCH_LIMITS.near_nats) == (2.0, 1.0)
        assert JUDGE_LIMITS.rival_nats == 8.0
    with pytest.raises(InputRefused), limit_set_to("gate_p_value", 0.5):
        raise InputRefused("take", "poses", "cannot be followed", "look")
    assert (JUDGE_LIMITS.rival_nats, SEARCH_LIMITS.near_nats, SEARCH_LIMITS.gate_p_value) == (4.0, 10.0, 1e-4)
    with pytest.raises(KeyError), limit_set_to("max_twins", 1):
        pass
    with pytest.raises(FrozenInstanceError):
        JUDGE_LIMITS.rival_nats = 1.0  # type: ignore[misc]


def test_a_whole_number_stays_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DECIDING_LIMITS, "max_candidates", SEARCH_LIMITS)
    monkeypatch.setitem(DECIDING_LIMITS, "max_twins", JUDGE_LIMITS)
    whole = [Variation("max_candidates", c).value for c in ("", "halved", "doubled")]
    assert whole == [4, 2, 8]
    assert all(isinstance(value, int) for value in whole)
    for most, halved in ((3, 2), (1, 1)):
        with limit_set_to("max_twins", most):
            assert Variation("max_twins", "halved").value == halved
    assert [Variation("gate_p_value", c).value for c in ("halved", "doubled")] == [0.5e-4, 2e-4]
    assert len(list_variations()) == 1 + 2 * len(DECIDING_LIMITS)


# the panel


def test_a_panel_is_drawn_by_lot_over_the_tiers() -> None:
    cases = BlindTest(3).cases
    panel = draw_panel(cases, 3)
    assert len(panel) == len({case.digest() for case in panel}) == 60
    tiers = [case.tier for case in panel]
    assert {tier: tiers.count(tier) for tier in tiers if tier != EXAMPLE.tier} == PANEL
    assert panel[0] is EXAMPLE
    few = draw_panel(cases, 3, 21)
    assert few == panel[:21]
    assert {case.tier for case in few} == {EXAMPLE.tier, *PANEL}
    assert draw_panel(cases, 3) == panel != draw_panel(cases, 4)


def test_the_example_is_the_take_of_the_sample_logs() -> None:
    """That is simulated with seed 1000 and its number."""
    other = next(take for take in TAKES if take.name == "another_day")
    again = simulate_drive(EXAMPLE.plant(), EXAMPLE.sensor(), 12.0, 1000 + TAKES.index(other))
    assert EXAMPLE.duration_s == other.duration_s
    assert dict(other.conceals).items() <= EXAMPLE.plant()._asdict().items()
    np.testing.assert_array_equal(replace(EXAMPLE, duration_s=12.0).simulate().pose, again.pose)


# refits that are kept


def test_a_refit_is_kept_while_it_may_be_and_looked_up_afterwards() -> None:
    made = list[float]()

    @kept_in_proofs
    def double(x: float, ys: Any = ()) -> list[float]:
        made.append(x)
        return [2.0 * x]

    kept, many = KeptFits(), np.zeros(200_000)
    assert double(1.0) == double(1.0) == [2.0]
    assert len(made) == 2
    with use_kept_fits(kept):
        first = double(1.0, ys=np.arange(3))
        assert double(1.0, ys=np.arange(3)) is first
        assert double(1.0, ys=np.arange(4)) is not first
        assert double(2.0, many) is double(2.0, many) is not double(2.0, many.copy())
        kept.is_open = False
        assert double(1.0, ys=np.arange(3)) is first
        assert double(5.0) is not double(5.0)
    assert double(1.0, ys=np.arange(3)) is not first
    assert kept.looked_up == 3
    assert content_key({"a": (1, 2.0)}) == content_key({"a": (np.float64(1.0), 2.0)}) != content_key({"a": (1, 2.5)})


def test_a_kept_step_names_every_limit_that_it_reads() -> None:
    """Of the modules in which steps are kept, and of those that they import: each limit stands with some step there."""
    for package in ("remainder.fit", "search.screen", "search.name_scores"):
        root = f"bcid.diagnosis.{package}"
        own = {name for module in import_closure([root]) if module.startswith("bcid.diagnosis.")
               for name in limits_read_in(module)}  # fmt: skip
        declared = {name for names in READ_LIMITS.values() for name in names}
        assert own <= declared, package
    assert limits_read_in("bcid.diagnosis.remainder.fit") == {"near_nats"}
    assert limits_read_in("bcid.diagnosis.remainder.explain") == {"remainder_error"}
    assert limits_read_in("bcid.diagnosis.remainder.waves") == {"min_wave_nats"}
    assert set(READ_LIMITS["explain"]) == {"remainder_error", "min_wave_nats"}
    for step in "fit_with_remainder", "add_beside_remainder", "allow_copies", "converge_further":
        assert READ_LIMITS[step] == ("near_nats",)
    assert READ_LIMITS["sample_null_gains"] == ("gate_p_value",)


def limits_read_in(module: str) -> set[str]:
    """The deciding limits of which a module reads the value."""
    path = Path(bcid.__file__).parent.parent / (module.replace(".", "/") + ".py")
    if not path.is_file() or module in ("bcid.diagnosis.limits", "bcid.diagnosis.kept_steps"):
        return set()
    read = re.findall(r"(?<!`)(?:SEARCH|JUDGE)_LIMITS\.(\w+)", path.read_text("utf-8"))
    return set(read) & set(DECIDING_LIMITS)


def test_a_kept_step_is_made_anew_where_a_limit_that_it_reads_is_another() -> None:
    made = list[float]()

    @kept_under("near_nats")
    def step(x: float) -> list[float]:
        made.append(x)
        return [x]

    with use_kept_fits(KeptFits()):
        first = step(1.0)
        with limit_set_to("min_wave_nats", 1.0):
            assert step(1.0) is first
        with limit_set_to("near_nats", 1.0):
            assert step(1.0) is not first
    assert len(made) == 2
    del READ_LIMITS[step.__qualname__]


def test_what_is_kept_depends_on_no_limit_that_is_varied() -> None:
    """Its module, and all that this imports, read neither those of the search nor those of judging."""
    files = [p for p in (Path(bcid.__file__).parent).rglob("*.py") if "@kept_in_proofs" in p.read_text("utf-8")]
    assert len(files) >= 2
    for file in files:
        module = ".".join(file.relative_to(Path(bcid.__file__).parent.parent).with_suffix("").parts)
        assert "bcid.diagnosis.limits" not in import_closure([module]), module


# verdicts


def rows_of(told: dict[tuple[str, str, str], dict[str, Any]]) -> list[VariedRow]:
    return [VariedRow(case, "yaw_scrub", limit, change, said) for (case, limit, change), said in told.items()]


VALUES = {
    "rival_nats": {"": 4.0, "halved": 2.0, "doubled": 8.0},
    "near_nats": {"": 9.0, "halved": 4.5, "doubled": 18.0},
}
ABOUT = {"seed": 1, "takes": 3, "tiers": {"single": 3}, "code": "c0de"}


def all_told(cases: Iterable[str]) -> dict[tuple[str, str, str], dict[str, Any]]:
    both = [(limit, change) for limit in VALUES for change in ("halved", "doubled")]
    return {(case, limit, change): NAMED for case in cases for limit, change in [("", ""), *both]}


def test_verdicts_that_change_are_counted_by_limit_and_told() -> None:
    told = all_told(["a", "b", "c"])
    told["a", "rival_nats", "doubled"] = UNKNOWN
    told["b", "rival_nats", "doubled"] = {**NAMED, "verdict": "ambiguous"}
    told["b", "near_nats", "halved"] = {"error": "ValueError('no')"}
    del told["c", "near_nats", "halved"]  # there was no time
    document = count_changes(rows_of(told), VALUES, ABOUT, "example-0000")
    rivals, near = document.limits
    assert (rivals.takes, rivals.changed_halved, rivals.changed_doubled) == (3, 0, 2)
    assert (near.takes, near.changed_halved, near.changed_doubled) == (2, 1, 0)
    assert rivals.changed_share == pytest.approx(2 / 6)
    assert document.diagnosed == 2
    assert [(c.case, c.limit, c.value, c.before, c.after) for c in document.changes] == [
        ("a", "rival_nats", 8.0, "named: yaw_scrub", "unknown in mz"),
        ("b", "rival_nats", 8.0, "named: yaw_scrub", "ambiguous: yaw_scrub"),
        ("b", "near_nats", 4.5, "named: yaw_scrub", "ValueError('no')"),
    ]
    assert [(f.case, f.limit, f.value) for f in document.failed] == [("b", "near_nats", 4.5)]
    assert document.missed == ("rival_nats: 2 of 6 verdicts change", "near_nats: 1 of 4 verdicts change")


def test_one_change_in_fifty_is_no_miss_but_for_the_example() -> None:
    told = all_told(f"case-{i}" for i in range(25))
    told["case-3", "rival_nats", "halved"] = UNKNOWN
    assert count_changes(rows_of(told), VALUES, ABOUT, "example-0000").missed == ()
    assert count_changes(rows_of(told), VALUES, ABOUT, "case-3").missed == ("case-3: changes where rival_nats is 2",)


def test_a_take_without_a_verdict_counts_for_no_limit_and_is_a_miss() -> None:
    told: dict[tuple[str, str, str], dict[str, Any]] = {("a", "", ""): {"error": "no"}}
    document = count_changes(rows_of(told), VALUES, ABOUT, "example-0000")
    assert [v.takes for v in document.limits] == [0, 0]
    assert document.limits[0].changed_share is None
    assert document.missed == ("a: no verdict",)


def test_limits_json_is_read_as_it_was_written(tmp_path: Path) -> None:
    told = all_told(["a"]) | {("a", "rival_nats", "halved"): UNKNOWN, ("b", "", ""): {"error": "no"}}
    document = count_changes(rows_of(told), VALUES, ABOUT, "a")
    document.write(tmp_path / "limits.json")
    assert VariedLimitsDocument.read(tmp_path / "limits.json") == document
    assert json.loads((tmp_path / "limits.json").read_text())["schema"] == "bcid.limits/1"


def test_an_error_is_that_of_its_limit_or_of_the_take(monkeypatch: pytest.MonkeyPatch) -> None:
    told = dict[Variation, dict[str, Any]]()

    class Told:
        def __init__(self, case: BlindCase) -> None:
            if case.tier == "null":
                raise InputRefused("take", "poses", "none", "look")

        def tell(self, variation: Variation) -> dict[str, Any]:
            if variation == Variation("rival_se", "doubled"):
                raise ArithmeticError("no")
            return NAMED

    monkeypatch.setattr("bcid.proof.blind.varied_take.VariedTake", Told)
    single, null = (next(c for c in draw_suite(1, 1, 1, 0, 0) if c.tier == tier) for tier in ("single", "null"))
    tell_variations(single, list_variations(), told.__setitem__, lambda: True)
    assert {v for v, row in told.items() if "error" in row} == {Variation("rival_se", "doubled")}
    assert set(told) == set(list_variations())
    told.clear()
    tell_variations(null, list_variations(), told.__setitem__, lambda: True)
    assert list(told) == [AS_THEY_ARE]
    assert "InputRefused" in told[AS_THEY_ARE]["error"]
    told.clear()
    tell_variations(single, list_variations(), told.__setitem__, lambda: len(told) < 3)
    assert len(told) == 3


# all of it


@pytest.fixture
def variations_asked_for(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Variation]]:
    """What was asked of a stand-in for the diagnosis, to which a take of nothing hangs on `near_nats`."""
    calls = list[tuple[str, Variation]]()

    def tell_stand_in(
        case: BlindCase, variations: Iterable[Variation], keep: Callable[..., None], in_time: Callable[[], bool]
    ) -> None:
        for variation in variations:
            calls.append((case.name, variation))
            hangs = case.tier == "null" and variation == Variation("near_nats", "doubled")
            keep(variation, UNKNOWN if hangs else NAMED)

    monkeypatch.setattr(runs, "tell_variations", tell_stand_in)
    monkeypatch.setattr("bcid.execution.jobs.make_pool", ThreadPool)
    return calls


@pytest.mark.parametrize("workers", [1, 3])
def test_verdicts_are_kept_and_only_those_that_lack_are_told(
    tmp_path: Path, variations_asked_for: list[tuple[str, Variation]], workers: int
) -> None:
    panel = draw_panel(BlindTest(1).cases, 1, 3)
    ended = list[int]()
    assert runs.vary_limits(panel, 1, tmp_path, workers, minutes=0.0).diagnosed == 0
    assert variations_asked_for == []
    document = runs.vary_limits(panel, 1, tmp_path, workers, progress=ended.append)
    assert len(variations_asked_for) == len(set(variations_asked_for)) == 3 * len(list_variations())
    assert ended == [1, 2, 3]
    assert document.diagnosed == document.takes == 3
    assert document.tiers == {"example": 1, "single": 1, "null": 1}
    assert document.missed == ("near_nats: 1 of 6 verdicts change",)
    file = tmp_path / "rows.jsonl"
    file.write_bytes(b"\n".join(file.read_bytes().splitlines()[:-2]) + b"\n")  # cut off before the last two
    assert runs.vary_limits(panel, 1, tmp_path, workers) == document
    assert len(variations_asked_for) == 3 * len(list_variations()) + 2
    assert len(read_rows(tmp_path)) == 3 * len(list_variations())


def ended_with(words: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    """Exit code of `bcid prove` with these words; 0 where it just returns."""
    monkeypatch.setattr("sys.argv", ["bcid", "prove", "--workers", "1", *words])
    try:
        main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def test_prove_limits_writes_and_prints_and_ends_with_5_where_too_many_change(
    tmp_path: Path, variations_asked_for: list[tuple[str, Variation]], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    words = ["--limits", "--out", str(tmp_path)]
    assert ended_with([*words, "--takes", "2", "--seed", "5"], monkeypatch) == 0
    assert VariedLimitsDocument.read(tmp_path / "limits.json").seed == 5
    assert ended_with([*words, "--takes", "3"], monkeypatch) == 5
    told = capsys.readouterr()
    assert "near_nats: 1 of 6 verdicts change" in told.err
    assert "near_nats = 20" in told.out
    assert "unknown in mz" in told.out
    assert VariedLimitsDocument.read(tmp_path / "limits.json").takes == 3
    # the example's are there
    assert len(variations_asked_for) == 2 * len(list_variations()) + 2 * len(list_variations())


def test_the_table_shows_each_limit_and_each_failure() -> None:
    from rich.console import Console

    told = all_told(["a"]) | {("b", "", ""): {"error": "it broke"}}
    console = Console(width=150)
    with console.capture() as printed:
        console.print(show.varied_limits_tables(count_changes(rows_of(told), VALUES, ABOUT, "a")))
    assert all(text in printed.get() for text in ("rival_nats", "0 (2)", "0 (8)", "it broke", "as they are"))


@pytest.mark.parametrize(
    "more",
    [
        ["--quick"], ["--real", "cases.toml"], ["--recordings", "folder"], ["--salt", "x", "--seed", "9"],
        ["--baselines"], ["--case", "single-0000"], ["--every", "2"], ["--nulls", "9"], ["--takes", "0"],
        ["--takes", "61"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_options_that_go_with_no_panel_are_refused(
    tmp_path: Path, more: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended_with(["--limits", "--out", str(tmp_path / "new"), *more], monkeypatch) == 2
    assert more[0] in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_takes_goes_with_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended_with(["--out", str(tmp_path / "new"), "--takes", "3"], monkeypatch) == 2
    assert "--takes goes with --limits" in capsys.readouterr().err


def test_a_short_take_is_told_its_verdict_with_other_limits() -> None:
    """A limit of judging needs no search; one of the search finds the refits of the first; all are put back."""
    cases = draw_suite(1, 1, 0, 0, 0)
    case = next(c for c in cases if c.tier == "single" and c.answer == ("rear_drag_asymmetry",))
    take = VariedTake(replace(case, duration_s=60.0))
    as_is = take.tell(AS_THEY_ARE)
    made = len(take.kept.by_arguments)
    assert as_is == {"verdict": "named", "names": ["rear_drag_asymmetry"], "channel": ""}
    assert made > 2
    assert take.tell(Variation("rival_nats", "halved")) == as_is
    assert take.kept.looked_up == 0
    assert take.tell(Variation("near_nats", "halved")) == as_is
    assert take.kept.looked_up >= made // 2
    assert len(take.kept.by_arguments) == made
    # as a search without kept refits
    take.kept = KeptFits()
    again = take.search()
    assert len(take.kept.by_arguments) == made
    assert again.gains == take.naming.gains
    assert told_verdict(again, take.base.take) == as_is
    assert (JUDGE_LIMITS.rival_nats, SEARCH_LIMITS.near_nats) == (4.0, 10.0)
    # nothing can be a name that must add as much as this
    with limit_set_to("gate_p_value", 1e-300):
        assert take.search().nulls.gate > 500.0

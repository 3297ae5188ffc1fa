"""Progress only goes forward, says how long the rest takes, and is printed as lines where nobody watches a bar."""

from __future__ import annotations

import io
import itertools
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

from bcid.cli import progress as shown
from bcid.cli.limits import LIMITS, CommandLimits
from bcid.cli.options import Format
from bcid.cli.progress import StageProgress, format_duration, print_lines, show_bar
from bcid.cli.sink import CleanConsole, Sink, is_column_of_figures, plain_table
from bcid.pipeline.progress import SAID_SHARES, TIME_SHARES, spread_rounds

if TYPE_CHECKING:
    from collections.abc import Iterator


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_a_share_never_falls_and_the_text_is_the_last() -> None:
    done = StageProgress()
    shares = []
    for share in (0.1, 0.8, 0.3, float("nan"), 0.85, 7.0, 0.0):
        done.advance(share, f"at {share}")
        shares.append(done.share)
    assert shares == [0.1, 0.8, 0.8, 0.8, 0.85, 1.0, 1.0]
    assert done.text == "at 0.0"


def test_the_time_left_is_that_of_the_rest_at_the_pace_so_far() -> None:
    clock = Clock()
    done = StageProgress(clock)
    clock.now_s += 10.0
    done.advance(LIMITS.min_share_to_extrapolate / 2.0, "")
    assert done.left_s is None  # too early to say
    clock.now_s += 20.0
    done.advance(0.25, "")
    assert done.left_s == pytest.approx(90.0)
    assert done.describe_times() == "30 s, about 1 min 30 s left"
    clock.now_s += 40.0
    done.advance(0.2, "goes back")  # the share stays, the time goes by
    assert done.left_s == pytest.approx(50.0)
    clock.now_s += 60.0
    assert done.left_s is None  # it takes longer than was thought
    done.advance(1.0, "")
    assert done.left_s is None


def test_times_are_told_as_people_tell_them() -> None:
    assert [format_duration(s) for s in (0.0, 59.6, 61.0, 3599.0, 3600.0, 5400.0)] == [
        "0 s", "1 min", "1 min 1 s", "59 min 59 s", "1 h", "1 h 30 min",
    ]  # fmt: skip


def diagnosis_calls(rounds: int) -> Iterator[tuple[float, str]]:
    """What a diagnosis with that many rounds of search says."""
    yield from ((0.02, "a first car"), (0.05, "the base model"))
    yield from ((0.3, f"round {i}") for i in range(rounds))
    yield from ((0.8, "what is left"), (0.85, "held-out proof"), (0.92, "what the error is made of"))


@pytest.mark.parametrize("rounds", [0, 1, 15, 400])
def test_a_diagnosis_goes_forward_with_every_round(rounds: int) -> None:
    told: list[float] = []
    advance = spread_rounds(lambda share, text: told.append(share))
    for share, text in diagnosis_calls(rounds):
        advance(share, text)
    assert len(told) == rounds + 5
    assert all(a <= b for a, b in itertools.pairwise(told))
    search = told[2 : 2 + rounds]
    assert all(a < b for a, b in itertools.pairwise(search[:30]))
    assert all(TIME_SHARES[3] <= share <= TIME_SHARES[4] for share in search)
    assert told[-1] == TIME_SHARES[SAID_SHARES.index(0.92)]


def test_shares_of_a_diagnosis_grow_together() -> None:
    for said in (SAID_SHARES, TIME_SHARES):
        assert all(a < b for a, b in itertools.pairwise(said))
        assert (said[0], said[-1]) == (0.0, 1.0)
    assert len(SAID_SHARES) == len(TIME_SHARES)


def test_the_diagnosis_says_the_shares_that_are_known_here() -> None:
    """A share that it says anew would be spread wrongly."""
    import ast
    from pathlib import Path

    import bcid.diagnosis.diagnose as diagnosis
    import bcid.pipeline.stages.diagnose as stage

    said = {
        call.args[0].value
        for module in (diagnosis, stage)
        for call in ast.walk(ast.parse(Path(module.__file__).read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "progress"
        if isinstance(call.args[0], ast.Constant)
    }
    assert said == set(SAID_SHARES) - {0.0, 1.0}


def test_lines_come_now_and_then_and_say_when_it_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown, "LIMITS", CommandLimits(min_line_gap_s=0.05, line_every_s=0.2))
    told = io.StringIO()
    with print_lines("diagnose", CleanConsole(file=told, width=200)) as advance:
        advance(0.1, "first")
        time.sleep(0.12)
        advance(0.42, "second")
        time.sleep(0.5)  # silence, in which a line comes all the same
    lines = told.getvalue().splitlines()
    assert lines[0].startswith("diagnose: 10 % after ")
    assert any("42 % after" in line and line.endswith("(second)") for line in lines)
    assert sum("(second)" in line for line in lines) >= 2
    assert lines[-1].startswith("diagnose: done after ")


def test_a_stage_that_is_soon_over_prints_no_line() -> None:
    told = io.StringIO()
    with print_lines("ingest", CleanConsole(file=told, width=200)) as advance:
        advance(0.9, "soon")
    assert told.getvalue() == ""


def test_a_bar_says_how_long() -> None:
    told = io.StringIO()
    console = CleanConsole(file=told, width=120, force_terminal=True, color_system=None)
    with show_bar("fit", console) as advance:
        advance(0.5, "epoch 5")
        time.sleep(0.2)
    assert "epoch 5" in told.getvalue()
    assert "0 s" in told.getvalue()


@pytest.mark.parametrize("style", [Format.json, Format.quiet])
def test_other_formats_get_no_lines(style: Format, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown, "LIMITS", CommandLimits(min_line_gap_s=0.01, line_every_s=0.01))
    sink, told = Sink(style), io.StringIO()
    sink.err, sink.lively = CleanConsole(file=told, width=100), False
    with sink.stage("fit") as advance:
        advance(0.5, "x")
        time.sleep(0.05)
    assert told.getvalue() == ""


def test_columns_of_text_are_left_and_of_figures_right() -> None:
    rows = [["newton-euler", "0.33", "0.28 – 0.39", "motive-csv", "–"], ["k-sindy", "−5.8", "–", "12 of them", ""]]
    table = plain_table("t", ["model", "NMSE", "interval", "format", "none"], rows)
    assert [c.justify for c in table.columns] == ["left", "right", "right", "left", "left"]
    assert is_column_of_figures(["≤ 3 ms", "± 2", "(3.5 ± 0.2) × 10⁻⁵"])
    assert not is_column_of_figures(["3 ms", "none: not estimated"])


INTERRUPTED_TWICE = """
import os, signal
from bcid.cli.exits import run_and_explain

def at_work():
    # as if the compiler were at work, which no exception may leave
    signal.raise_signal(signal.SIGINT)
    os.write(2, b"still at work\\n")

scope = {"__name__": "llvmlite.binding", "signal": signal, "os": os}
compiler = type(at_work)(at_work.__code__, scope)

def command():
    compiler()
    signal.raise_signal(signal.SIGINT)

# as `bcid` ends, before the interruption that was put off comes again
os._exit(run_and_explain(command))
"""


def test_ctrl_c_is_answered_at_once_and_once() -> None:
    """By the signal's handler, before what runs has ended, also where a compiler is at work that it may not enter."""
    from bcid.cli.exits import STOPPING

    done = subprocess.run([sys.executable, "-c", INTERRUPTED_TWICE], capture_output=True, text=True, check=False)
    assert done.returncode == 130
    assert done.stderr.splitlines() == [STOPPING, "still at work"]

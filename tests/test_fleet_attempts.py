"""Steps of a fleet that fail: what may be over a moment later is tried again, what is an answer is not."""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from bcid.errors import InputRefused
from bcid.fleet import attempts
from bcid.fleet.attempts import FEWER_JOBS, WAITS_S, TakeLocked, attempt
from bcid.fleet.tasks import _LogWork
from bcid.store.artifact import Artifact


def stale() -> OSError:
    return OSError(errno.ESTALE, "Stale file handle", "/far/log.csv")


def unreadable(because: OSError) -> InputRefused:
    refused = InputRefused("log.csv", "", "it cannot be read", "look at the disk")
    refused.__cause__ = because
    return refused


def failing(errors: Sequence[Exception]) -> tuple[Callable[[], str], list[int]]:
    """A step that raises one error after the other, and then gives "done"; how often it was tried."""
    left, tried = list(errors), list[int]()

    def step() -> str:
        tried.append(len(tried))
        if left:
            raise left.pop(0)
        return "done"

    return step, tried


@pytest.fixture
def waits_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The seconds of each wait that was asked for; none is waited."""
    seconds = list[float]()
    monkeypatch.setattr(attempts.time, "sleep", seconds.append)
    return seconds


@pytest.mark.parametrize("errors", [[stale()], [unreadable(stale()), stale()]])
def test_a_folder_that_is_away_for_a_moment_costs_no_log(errors: list[Exception], waits_s: list[float]) -> None:
    step, _ = failing(errors)
    assert attempt("ingest", step) == ("done", [])
    assert waits_s == [*WAITS_S][: len(errors)]


def test_one_that_stays_away_is_a_problem_with_a_next_step(waits_s: list[float]) -> None:
    step, tried = failing([stale()] * 9)
    result, (problem,) = attempt("ingest", step)
    assert result is None
    assert (problem.stage, problem.error) == ("ingest", "OSError")
    assert "/far/log.csv: Stale file handle" in problem.text
    assert "next: see whether the disk, or the machine that has the folder, answers" in problem.text
    assert (len(tried), waits_s) == (1 + len(WAITS_S), [*WAITS_S])


def test_a_step_that_is_done_twice_keeps_what_it_made_once(waits_s: list[float]) -> None:
    """An artifact that was kept before the folder went away is that of the second try, too."""
    work, errors = _LogWork.__new__(_LogWork), [stale()]
    work.artifacts, work.problems = [], []

    def diagnose() -> None:
        for stage in ("diagnose", "diagnosis_page"):
            work._keep(stage, Artifact(Path("workspace"), "0" * 64, False))
            if errors:
                raise errors.pop()

    assert work._does("diagnose", diagnose)
    assert [artifact.stage for artifact in work.artifacts] == ["diagnose", "diagnosis_page"]
    assert waits_s == [WAITS_S[0]]


@pytest.mark.parametrize(
    "error",
    [
        FileNotFoundError(errno.ENOENT, "No such file or directory", "log.csv"),
        PermissionError(errno.EACCES, "Permission denied", "log.csv"),
        OSError(errno.ENOSPC, "No space left on device", "workspace"),
        InputRefused("log.csv", "line 3", "no number", "mend it"),
        ZeroDivisionError(),
    ],
)
def test_what_would_fail_again_is_not_tried_again(error: Exception, waits_s: list[float]) -> None:
    step, tried = failing([error])
    assert attempt("ingest", step).result is None
    assert (len(tried), waits_s) == (1, [])


def test_a_log_that_needs_more_memory_than_there_is_is_no_fault_of_the_program(waits_s: list[float]) -> None:
    step, _ = failing([MemoryError()])
    (problem,) = attempt("fit", step).problems
    assert problem.text == f"out of memory\n  next: {FEWER_JOBS}"


def test_a_lock_is_left_to_whoever_comes_back(waits_s: list[float]) -> None:
    step, tried = failing([TakeLocked("at work")])
    with pytest.raises(TakeLocked):
        attempt("ingest", step)
    assert (len(tried), waits_s) == (1, [])

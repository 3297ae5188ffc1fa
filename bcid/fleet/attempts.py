"""Steps whose failure must not end the others: what each gave, or why it failed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from bcid.documents.fleet import LogProblem
from bcid.errors import BcidError
from bcid.execution.jobs import ProcessLost

Result = TypeVar("Result")
REPORT_IT = "run this log alone with BCID_TRACEBACK=1 and report it"
LOST = "its process died each time that it was tried: out of memory, or killed"
FEWER_JOBS = "give it fewer --jobs (or each machine of a cluster fewer workers), or look into the system's log"


class TakeLocked(Exception):
    """Another process is at work on what this task needs next."""


class Attempt(NamedTuple, Generic[Result]):
    """What a step gave, or None and why it failed."""

    result: Result | None
    problems: list[LogProblem]


def attempt(stage: str, step: Callable[[], Result], if_internal: str = REPORT_IT) -> Attempt[Result]:
    """Do a step whose failure must not end the others; a lock is no failure, as it is come back to.

    `if_internal` is the next step after an error that is none of the input.
    """
    try:
        return Attempt(step(), [])
    except TakeLocked:
        raise
    except Exception as error:  # whatever one log does to the program, the others go on
        return Attempt(None, [LogProblem(stage=stage, error=type(error).__name__, text=_describe(error, if_internal))])


def describe_lost_process(stage: str) -> LogProblem:
    """Why a step whose process died again and again gave nothing."""
    return LogProblem(stage=stage, error=ProcessLost.__name__, text=f"{LOST}\n  next: {FEWER_JOBS}")


def _describe(error: Exception, if_internal: str) -> str:
    """Cause and next step of an error."""
    if isinstance(error, BcidError):
        return str(error)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}\n  next: check the path and its permissions"
    return f"internal error, {type(error).__name__}: {error}\n  next: {if_internal}"

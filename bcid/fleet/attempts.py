"""Steps whose failure must not end the others: what each gave, or why it failed."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

from bcid.documents.fleet import LogProblem
from bcid.errors import BcidError
from bcid.execution.jobs import ProcessLost

Result = TypeVar("Result")
REPORT_IT = "run this log alone with BCID_TRACEBACK=1 and report it"
LOST = "its process died each time that it was tried: out of memory, or killed"
PASSING = frozenset(
    getattr(errno, name)
    for name in (
        "EAGAIN", "EBUSY", "ECONNABORTED", "ECONNRESET", "EHOSTDOWN", "EHOSTUNREACH", "EINTR", "EIO", "ENETDOWN",
        "ENETUNREACH", "ENOLCK", "ENOTCONN", "EPIPE", "ESTALE", "ETIMEDOUT",
    )
    if hasattr(errno, name)
)  # fmt: skip
"""Errors of a disk, or of a folder on another machine, that may be over a moment later."""
WAITS_S = (1.0, 5.0)
"""Seconds that are waited before a step that failed by such an error is done anew, each time."""
FEWER_JOBS = "give it fewer --jobs (or each machine of a cluster fewer workers), or look into the system's log"


class TakeLocked(Exception):
    """Another process is at work on what this task needs next."""


class Attempt(NamedTuple, Generic[Result]):
    """What a step gave, or None and why it failed."""

    result: Result | None
    problems: list[LogProblem]


def attempt(
    stage: str, step: Callable[[], Result], if_internal: str = REPORT_IT, waits_s: Sequence[float] = WAITS_S
) -> Attempt[Result]:
    """Do a step whose failure must not end the others; a lock is no failure, as it is come back to.

    What may be over a moment later, as where a shared folder is away, is tried again after each of `waits_s`; a step
    must be one that may be done twice.  `if_internal` is the next step after an error that is none of the input.
    """
    try:
        return Attempt(step(), [])
    except TakeLocked:
        raise
    except Exception as error:  # whatever one log does to the program, the others go on
        if not (waits_s and _may_pass(error)):
            text = _describe(error, if_internal)
            return Attempt(None, [LogProblem(stage=stage, error=type(error).__name__, text=text)])
    time.sleep(waits_s[0])
    return attempt(stage, step, if_internal, waits_s[1:])


def _may_pass(error: BaseException | None) -> bool:
    """Whether an error, or one that it was raised from, may be over a moment later."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in PASSING:
            return True
        error = error.__cause__ or error.__context__
    return False


def describe_lost_process(stage: str) -> LogProblem:
    """Why a step whose process died again and again gave nothing."""
    return LogProblem(stage=stage, error=ProcessLost.__name__, text=f"{LOST}\n  next: {FEWER_JOBS}")


def _describe(error: Exception, if_internal: str) -> str:
    """Cause and next step of an error."""
    if isinstance(error, BcidError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"out of memory\n  next: {FEWER_JOBS}"
    if isinstance(error, OSError) and error.filename is not None:
        away = "see whether the disk, or the machine that has the folder, answers, and run the command again"
        next_step = away if error.errno in PASSING else "check the path and its permissions"
        return f"{error.filename}: {error.strerror}\n  next: {next_step}"
    return f"internal error, {type(error).__name__}: {error}\n  next: {if_internal}"

"""The errors a user may meet, each with what to do next, and the exit code that goes with it."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple


class Problem(NamedTuple):
    """One thing that is wrong with a file."""

    place: str
    cause: str
    next_step: str
    source: str = ""  # the file; empty for the one that is being checked


class BcidError(Exception):
    """Base of all errors that are told in one message, without a traceback."""

    exit_code = 1


class UsageError(BcidError):
    """The command's words do not fit together."""

    exit_code = 2


class GoalMissed(BcidError):
    """Done, but a stated goal was missed."""

    exit_code = 5


class PartLost(BcidError):
    """Done, but a part of the input could not be read and was left out, as was allowed."""

    exit_code = 3


class InputRefused(BcidError):
    """A file that cannot be used as it is: which, where in it, why, and what to do; or several such `problems`."""

    exit_code = 4

    def __init__(
        self, source: str | Path, place: str, cause: str, next_step: str, problems: Sequence[Problem] = ()
    ) -> None:
        self.source, self.place, self.cause, self.next_step = str(source), place, cause, next_step
        self.problems = tuple(problems) or (Problem(place, cause, next_step, self.source),)
        super().__init__("\n".join(f"{p.source}: {p.place}: {p.cause}\n  next: {p.next_step}" for p in self.problems))

    def __reduce__(self) -> tuple[Any, ...]:
        """From one process to another with all that it tells."""
        return type(self), (self.source, self.place, self.cause, self.next_step, self.problems)


class DiskFull(BcidError):
    """A file could not be written whole; what was finished before stands."""

    exit_code = 4

    def __init__(self, place: str | Path) -> None:
        super().__init__(
            f"{place}: the disk or the quota is full\n"
            "  next: free some space and run again; what is finished is kept and will be reused"
        )


def is_disk_full(error: BaseException) -> bool:
    """Whether an error, or what it came of, says that no more can be written; libraries tell it in words only."""
    told = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    words = any(os.strerror(code) in str(error) for code in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
    cause = error.__cause__ or error.__context__
    return told or words or (cause is not None and is_disk_full(cause))


class Problems(list[Problem]):
    """What is wrong with a recording, gathered so that all of it is told at once."""

    @contextmanager
    def gathered(self) -> Iterator[None]:
        """A check whose refusal waits for the others."""
        try:
            yield
        except InputRefused as error:
            self.extend(error.problems)

    def refuse(self, source: str | Path) -> None:
        """Raise one `InputRefused` that tells all of them; nothing where there are none.

        What names no file is wrong with `source`; what ails several places in the same way is told once.
        """
        if not self:
            return
        alike = dict[Problem, list[str]]()
        for p in self:
            alike.setdefault(p._replace(place="", source=p.source or str(source)), []).append(p.place)
        told = [p._replace(place=", ".join(dict.fromkeys(places))) for p, places in alike.items()]
        causes = [p.cause if len(told) == 1 else f"{p.place}: {p.cause}" for p in told]
        steps = dict.fromkeys(p.next_step for p in told)
        places = ", ".join(p.place for p in told)
        raise InputRefused(told[0].source, places, "; ".join(causes), "; ".join(steps), told)

"""The errors that a user may meet, each with what to do next and an exit code, and the one that searches catch."""

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unicodedata import category


def printable(text: str, kept: str = "\n") -> str:
    r"""The text with a replacement sign for each character that a terminal might obey; those in `kept` stay.

    Such are control characters, marks that turn the direction of writing, and bytes of file names that are no text.
    All that is printed of names (files, takes, bodies, topics, columns) passes through here.

    >>> printable("take\x1b[31m.csv")
    'take�[31m.csv'
    """
    # blanks of any width are no danger, though Python calls all but one unprintable
    return "".join(c if c.isprintable() or c in kept or category(c) == "Zs" else "�" for c in text)


def shorten(text: str, length: int) -> str:
    """The text, or its first `length` characters and an ellipsis."""
    return text[:length] + "…" if len(text) > length else text


class Problem(NamedTuple):
    """One thing that is wrong with a file."""

    place: str
    cause: str
    next_step: str
    source: str = ""  # the file; empty for the one that is being checked


def _describe_problem(problem: Problem) -> str:
    """A problem as two lines: where and what it is, and the next step; no name in it can begin a line of its own."""
    source, place = printable(problem.source, ""), printable(problem.place, "")
    return f"{source}: {place}: {printable(problem.cause)}\n  next: {printable(problem.next_step)}"


class BcidError(Exception):
    """Base of all errors that the command line reports in one message, without a traceback."""

    exit_code = 1


class UsageError(BcidError):
    """The options and arguments of a command do not fit together."""

    exit_code = 2


class LibraryMissing(BcidError):
    """What is asked for needs a library that a base installation goes without (`bcid.libraries`)."""

    exit_code = 2


class GoalMissed(BcidError):
    """The work is done, but a stated goal was missed."""

    exit_code = 5


class PartLost(BcidError):
    """The work is done, but a part is missing: input that could not be read, or one of several results that failed."""

    exit_code = 3


class OutputClosed(BcidError):
    """Whoever reads what a command prints stopped before its end."""

    # 128 and the number of SIGPIPE, by which other programs end then
    exit_code = 141

    def __init__(self) -> None:
        super().__init__(
            "stdout: was closed before everything was printed\n  next: read it to its end, or use --format quiet"
        )


class InputRefused(BcidError):
    """A file that cannot be used as it is: which, where in it, why, and what to do; or several such `problems`."""

    exit_code = 4

    def __init__(
        self, source: str | Path, place: str, cause: str, next_step: str, problems: Sequence[Problem] = ()
    ) -> None:
        self.source, self.place, self.cause, self.next_step = str(source), place, cause, next_step
        self.problems = tuple(problems) or (Problem(place, cause, next_step, self.source),)
        super().__init__("\n".join(_describe_problem(p) for p in self.problems))

    def __reduce__(self) -> tuple[Any, ...]:
        """How the error is pickled, so that it reaches another process with all its problems."""
        return type(self), (self.source, self.place, self.cause, self.next_step, self.problems)


class DiskFull(BcidError):
    """A file could not be written whole because the disk is full; what was finished before stands."""

    exit_code = 4

    def __init__(self, place: str | Path) -> None:
        super().__init__(
            f"{place}: the disk or the quota is full\n"
            "  next: free some space and run again; what is finished is kept and will be reused"
        )


class PredictionDiverged(ArithmeticError):
    """A prediction, or a likelihood computed from one, left the finite numbers.

    No `BcidError`: a search goes on without such parameters, and only where none are left is the recording refused.
    """


def is_disk_full(error: BaseException) -> bool:
    """Whether `error`, or an error that caused it, says that the disk, quota or file size is exhausted.

    Some libraries say so in words only, so messages are searched for the operating system's texts, too.
    """
    codes = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    by_code = isinstance(error, OSError) and error.errno in codes
    by_words = any(os.strerror(code) in str(error) for code in codes)
    cause = error.__cause__ or error.__context__
    return by_code or by_words or (cause is not None and is_disk_full(cause))


class Problems(list[Problem]):
    """What is wrong with a recording, collected so that all of it is reported at once."""

    @contextmanager
    def gather_refusals(self) -> Iterator[None]:
        """Context in which an `InputRefused` is added to the problems instead of raised."""
        try:
            yield
        except InputRefused as error:
            self.extend(error.problems)

    def raise_if_any(self, source: str | Path) -> None:
        """Raise one `InputRefused` with all problems; do nothing where there are none.

        A problem without a file is one of `source`; one that several places share is reported once.
        """
        if not self:
            return
        places_of = dict[Problem, list[str]]()
        for p in self:
            places_of.setdefault(p._replace(place="", source=p.source or str(source)), []).append(p.place)
        merged = [p._replace(place=", ".join(dict.fromkeys(places))) for p, places in places_of.items()]
        causes = [p.cause if len(merged) == 1 else f"{p.place}: {p.cause}" for p in merged]
        steps = dict.fromkeys(p.next_step for p in merged)
        places = ", ".join(p.place for p in merged)
        raise InputRefused(merged[0].source, places, "; ".join(causes), "; ".join(steps), merged)

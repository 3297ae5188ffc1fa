"""The errors a user may meet, each with what to do next, and the exit code that goes with it."""

from __future__ import annotations

from pathlib import Path


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
    """A file that cannot be used as it is: which, where in it, why, and what to do."""

    exit_code = 4

    def __init__(self, source: str | Path, place: str, cause: str, next_step: str) -> None:
        self.source, self.place, self.cause, self.next_step = str(source), place, cause, next_step
        super().__init__(f"{self.source}: {place}: {cause}\n  next: {next_step}")

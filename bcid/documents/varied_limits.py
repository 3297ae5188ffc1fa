"""limits.json: how many verdicts change where a limit that decides is halved or doubled."""

from typing import Literal

from pydantic import Field

from bcid.documents.document import Document, Number, Part


class VariedLimit(Part):
    """One limit: its value, and how many verdicts are others with half and with twice of it."""

    limit: str
    value: float
    halved: float  # its value, halved
    doubled: float
    takes: int  # whose verdict is known with each of the three values
    changed_halved: int
    changed_doubled: int
    changed_share: Number = None  # of all verdicts with another value; null where there is none


class ChangedVerdict(Part):
    """A take that is told another verdict where a limit has another value, and both verdicts in words."""

    case: str
    there: str  # effects that are concealed
    limit: str
    value: float
    before: str
    after: str


class FailedTake(Part):
    """A take without a verdict, and why; "limit" and "value" are there where only that value has none."""

    case: str
    error: str
    limit: str = ""
    value: Number = None


class VariedLimitsDocument(Document):
    """The whole of limits.json (`bcid.limits/1`)."""

    kind: Literal["bcid.limits/1"] = Field("bcid.limits/1", alias="schema")
    seed: int
    takes: int  # of the panel
    tiers: dict[str, int]  # takes of each
    diagnosed: int  # takes that have a verdict with every value of every limit
    code: str  # digest of the code that makes a row
    limits: tuple[VariedLimit, ...]
    changes: tuple[ChangedVerdict, ...] = ()
    failed: tuple[FailedTake, ...] = ()
    goal: float  # largest share of verdicts that may change with a limit
    missed: tuple[str, ...] = ()  # in words

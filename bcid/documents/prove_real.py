"""real.json: the answers to questions about real recordings, and figures of them beside their goals."""

from typing import Any, Literal

from pydantic import Field

from bcid.documents.document import Document, Interval, Number, Part


class RealFigure(Part):
    """A figure of the answers: how many of how many, or a mean, with its exact 95 % interval and what is wanted."""

    figure: str
    n: int  # questions, drives or pairs that it is of
    hits: Number = None  # how many of them; null where it is no share
    value: Number = None  # null where there are none
    ci95: Interval | None = None  # Clopper-Pearson of a share, Garwood of a mean count
    goal: Interval | None = None  # lowest and highest wanted value
    missed: bool = False


class RealProofDocument(Document):
    """The whole of real.json (`bcid.prove-real/2`)."""

    kind: Literal["bcid.prove-real/2"] = Field("bcid.prove-real/2", alias="schema")
    code: str  # digest of the code that makes a row
    figures: tuple[RealFigure, ...]
    rows: tuple[dict[str, Any], ...]  # every answer, by tier, recording and case
    missed: tuple[str, ...] = ()  # figures outside their goals, in words

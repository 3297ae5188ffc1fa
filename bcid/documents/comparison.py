"""comparison of two runs, `bcid compare --format json`: what differs between two fits or diagnoses, and by how much."""

from typing import Literal

from pydantic import Field

from bcid.documents.diagnosis import Quantity
from bcid.documents.document import Document, Figure, Number, Part


class ConstantChange(Part):
    """One constant in both runs, and its change from the first to the second."""

    symbol: str  # of an effect's parameter: EFFECT SYMBOL
    one: Quantity
    other: Quantity
    change: Figure
    change_se: Figure
    share: Number = None  # the change over the first value
    z: Figure
    differs: bool  # whether |z| is beyond what chance allows for all constants together
    least_visible: Figure  # the smallest change that would have differed


class LoneFinding(Part):
    """An effect that the diagnosis of only one run names."""

    effect: str
    found_in: Literal["one", "other"]
    sentence: str = ""
    decides: bool  # whether the run without it would have named it, were it there
    why_not: str = ""  # where it would not: the reason in words


class ModelComparison(Part):
    """A model of the first run beside that of the second."""

    one: str  # names
    other: str
    verdict: Literal["same", "different", "undecided"]
    sentence: str
    chance: Number = None  # how often fits of one car differ in any constant by as much, at most
    z_needed: Figure
    constants: tuple[ConstantChange, ...] = ()
    only_one: tuple[str, ...] = ()  # constants that only the first run identifies
    only_other: tuple[str, ...] = ()
    lone_findings: tuple[LoneFinding, ...] = ()
    cautions: tuple[str, ...] = ()  # why the verdict may be worth less than it says
    notes: tuple[str, ...] = ()  # what was brought to a common footing, or left out


class ComparisonDocument(Document):
    """Two runs compared (`bcid.compare/1`), a diagnosis before fits."""

    kind: Literal["bcid.compare/1"] = Field("bcid.compare/1", alias="schema")
    one: str  # as they were named
    other: str
    models: tuple[ModelComparison, ...]

"""model_card.json: what a model or a comparison was made from, when and how, where it holds, and what it is not for."""

from typing import Literal

from pydantic import Field

from bcid.documents.diagnosis import BaseParameter
from bcid.documents.document import Document, Figure, Part


class DataFile(Part):
    """A file that went in, without its folder."""

    name: str
    sha256: str
    format: str = ""
    recorded: str | None = None  # when, as far as the file says, in its own words or UTC


class DataSpan(Part):
    """The lowest and the highest value of a quantity in the data."""

    quantity: str
    unit: str
    low: Figure
    high: Figure


class NoiseLevel(Part):
    """A standard deviation that was fitted beside the model."""

    name: str
    value: Figure
    unit: str


class ModelCard(Document):
    """The whole of model_card.json (`bcid.model-card/1`)."""

    kind: Literal["bcid.model-card/1"] = Field("bcid.model-card/1", alias="schema")
    vehicle: str
    vehicle_file: DataFile
    data: tuple[DataFile, ...]
    duration_s: Figure  # of all recordings together
    made: str  # date and time in UTC (ISO 8601)
    program: str  # with its version
    command: str = ""  # the command line; empty where it was made from Python
    model: str = ""  # what kind of model it is; empty for a comparison of several
    period_s: float | None = None  # of its steps
    parameters: tuple[BaseParameter, ...] = ()  # fitted ones
    noise: tuple[NoiseLevel, ...] = ()
    spans: tuple[DataSpan, ...] = ()  # of motion and commands in the data, without a validation take
    validation_spans: tuple[DataSpan, ...] = ()  # in the take that only judges, of a comparison
    not_for: tuple[str, ...] = ()  # sentences

"""pool.json: what recordings of one car say together, and how each of them differs."""

from typing import Literal

from pydantic import Field

from bcid.documents.document import Document, Figure, Part


class PooledConstant(Part):
    """A constant that all recordings share."""

    symbol: str
    value: Figure
    se: Figure
    unit: str
    scatter: Figure  # relative standard deviation from recording to recording, beside what is named


class PooledFactor(Part):
    """A factor by which a recording differs from those that it is compared with."""

    name: str
    factor: Figure
    se: Figure


class PooledRecording(Part):
    """One recording, and how it differs."""

    name: str
    duration_s: Figure
    reference: bool  # whether it is one of those that all are compared with
    factors: tuple[PooledFactor, ...]


class PooledAlternative(Part):
    """What may differ in the place of a factor, and by how many nats that makes the recordings likelier."""

    named: str
    other: str
    nats: Figure


class PoolDocument(Document):
    """What recordings of one car say together."""

    kind: Literal["bcid.pool/1"] = Field("bcid.pool/1", alias="schema")
    vehicle: str
    constants: tuple[PooledConstant, ...]
    recordings: tuple[PooledRecording, ...]
    alternatives: tuple[PooledAlternative, ...] = ()  # the likeliest first
    spreads: dict[str, Figure]  # relative standard deviation of each factor from recording to recording

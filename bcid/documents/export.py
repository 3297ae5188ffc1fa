"""What NAME.json beside an export says of it: what its numbers are, where it holds, and how it was checked."""

from typing import Annotated, Literal

from pydantic import Field

from bcid.documents.document import Document, Part
from bcid.documents.report import ProcessNoiseFigures
from bcid.errors import PartLost


class ExportedQuantity(Part):
    """One number of a state or a command."""

    name: str
    unit: str  # empty for a number without one
    meaning: str
    low: float | None = None  # over the data that the model was fitted on, where it is known
    high: float | None = None


class ExportedFormat(Part):
    """One format: its files, and the largest error of a twist (m/s, rad/s) over the drive of the test vectors."""

    format: str
    files: tuple[str, ...]
    error: float | None  # null where it could not be run here
    not_checked: str = ""  # why


class ExportedStart(Part):
    """The model's own first state at a pose, a twist and a steering angle, its past not known."""

    pose: tuple[float, float, float]  # m, m, rad
    twist: tuple[float, float, float]  # m/s, m/s, rad/s
    delta: float  # rad
    state: tuple[float, ...]


class ExportedVectors(Part):
    """A drive by the model itself and some of its first states, with which every format was compared."""

    pose: tuple[float, float, float]  # m, m, rad
    twist: tuple[float, float, float]  # m/s, m/s, rad/s
    delta: float  # rad
    commands: tuple[tuple[float, float], ...]
    twists: tuple[tuple[float, float, float], ...]  # after each command
    states: tuple[tuple[float, ...], ...] | None  # before each command, where every step starts from the model's own
    tolerance: Annotated[float, Field(gt=0.0)]  # of a twist: m/s, rad/s
    end_pose: tuple[float, float, float]  # m, m, rad, after the last command
    starts: tuple[ExportedStart, ...]


class ExportDocument(Document):
    """The whole of NAME.json."""

    kind: Literal["bcid.export/1"] = Field("bcid.export/1", alias="schema")
    name: str
    model: str
    model_digest: str  # SHA-256 of the saved model's model.json, which holds that of its arrays
    made_by: str
    of: Literal["recording", "vehicle"]  # with the effects of how poses were measured, or without
    time_s: float | None  # at which effects of the recording's time stand; null where they go on, or there are none
    point: str  # of the vehicle, whose poses and twists these are
    period_s: Annotated[float, Field(gt=0.0)]
    states: tuple[ExportedQuantity, ...]
    commands: tuple[ExportedQuantity, ...]
    twist: tuple[ExportedQuantity, ...]
    steering_limit_rad: float | None  # beyond which a steering command is clipped, to either side; null where it is not
    constants: dict[str, float]  # named in the formulas
    process_noise: ProcessNoiseFigures | None
    formats: tuple[ExportedFormat, ...]
    refused: dict[str, str] = Field(default_factory=dict)  # formats that were asked for, and why they are not there
    vectors: ExportedVectors

    def raise_if_refused(self) -> None:
        """Raise `PartLost` where formats that were asked for are not there, with the cause of each."""
        if self.refused:
            raise PartLost("\n".join(f"{name} is not written: {why}" for name, why in self.refused.items()))

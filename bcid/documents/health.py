"""What `bcid ingest --check` says of recordings: whether each is worth fitting, and why not."""

from typing import Literal

from pydantic import Field

from bcid.documents.document import Document, Figure, Interval, Number, Part


class ClockEstimate(Part):
    """Offset and drift of the command clock against the pose clock; null where `reason` says why they are not known.

    Offset and, where the vehicle file does not state it, the servo's time constant are found together, so that the
    offset is what remains beyond the servo; its interval includes the method's systematic error.
    """

    applied_s: float = 0.0  # the offset that the vehicle file states, added to the command times
    offset_s: Number = None  # what would have to be added beyond that
    offset_ci95: Interval | None = None  # s
    drift: Number = None  # s/s
    drift_ci95: Interval | None = None  # s/s
    blocks: int = 0  # of the take, that show a delay each
    explained: Figure = 0.0  # share of the yaw rate's variance that the commands explain
    reason: str | None = None


class YawOffset(Part):
    """Yaw of the tracked body minus that of the car (rad), with its 95 % interval."""

    rad: float
    low: float
    high: float


class HealthFigures(Part):
    """The figures of a take by which its health is judged."""

    duration_s: float
    moving_s: Figure  # for which the car moves and its pose is known
    pose_coverage: Figure  # share of the frames whose pose is known
    command_coverage: Figure  # share of the poses at which a command holds
    top_speed_mps: Figure
    yaw_offset_rad: YawOffset | None = None


class RefusalProblem(Part):
    """One thing that is wrong with a file, as `InputRefused` states it."""

    place: str
    cause: str
    next_step: str
    source: str = ""


class TakeHealth(Part):
    """Whether a take is worth fitting (`go`), in one sentence and in detail, or why it is refused."""

    recording: str = ""  # path of its file
    go: bool
    sentence: str
    reasons_against: tuple[str, ...] = ()  # fitting it
    not_excited: tuple[str, ...] = ()  # constants that no fit can find in it
    findings: tuple[str, ...] = ()  # irregularities to look at
    figures: HealthFigures | None = None
    clock: ClockEstimate | None = None
    lost: bool = False  # a part of the file could not be read
    refused: str | None = None
    problems: tuple[RefusalProblem, ...] = ()


class HealthDocument(Document):
    """The health of several recordings (`bcid.health/2`)."""

    kind: Literal["bcid.health/2"] = Field("bcid.health/2", alias="schema")
    recordings: tuple[TakeHealth, ...]

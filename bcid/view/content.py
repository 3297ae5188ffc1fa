"""What a view shows: a take and its estimated motion, predictions of it, and what a diagnosis found in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from bcid.aliases import Floats
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import RestartedPrediction, predict_with_restarts
from bcid.models.interface import Model
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

RESTART_S = 2.0
"""Time (s) after which predictions start anew from the measured state: that of a diagnosis's page."""


class Attachment(NamedTuple):
    """A file that goes into the view whole: its name, media type and content."""

    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis, and the accelerations that model and take differ by over each knot of this take.

    A knot is a stretch of 0.25 s.  `knots` holds columns (K,) by the names of `bcid.diagnosis.summary.KNOT_UNITS`;
    `time_s` is the middle of each knot on the recording's clock.
    """

    document: DiagnosisDocument
    knots: Mapping[str, Floats]


@dataclass(frozen=True)
class ViewContent:
    """All that a view shows.  Times of recording, estimate and diagnosis count from `zero_ns` (ns)."""

    recording: Recording
    estimate: Estimate
    vehicle: Vehicle
    zero_ns: int = 0
    # by what they are called: "predicted", or "before" and "after" of a diagnosis; rows as in the estimate
    predictions: Mapping[str, RestartedPrediction] = field(default_factory=dict)
    diagnosed: Diagnosed | None = None
    attachments: tuple[Attachment, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)  # digests of what the view was made from, by name

    def stamp_ns(self, time_s: float) -> int:
        """The stamp (ns) of a time (s) of the recording."""
        return self.zero_ns + round(time_s * 1e9)


def predict_windows(model: Model, estimate: Estimate) -> RestartedPrediction:
    """Open-loop predictions through a take, each begun at the measured state and RESTART_S long."""
    return predict_with_restarts(model, estimate, RESTART_S)


def earliest_zero_ns(recording: Recording) -> int:
    """The stamp (ns) of the time zero of a recording whose clock has no date: 0, or what keeps all stamps above 0.

    Commands may begin before the poses, from which times count; stamps below zero cannot be written.  The zero is then
    a whole number of seconds.
    """
    streams = (recording.poses, recording.commands, *recording.channels.values())
    earliest_s = min(float(stream.time_s[0]) for stream in streams)
    return max(0, -int(earliest_s // 1.0)) * 1_000_000_000

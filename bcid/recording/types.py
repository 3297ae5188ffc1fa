"""`Recording`: a pose stream and a command stream, where they came from, and what was odd about them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bcid.aliases import Floats
from bcid.documents.health import ClockEstimate

COMMANDS_FORMAT = "commands-csv"
"""The format of a file that holds the commands of a recording and no poses."""

BRAKE_CHANNEL = "brake_share"
"""The channel of a brake that is no part of the throttle, from 0 to 1."""

Action = Literal["fixed", "excluded", "warning", "no-go"]
"""What becomes of an irregularity: mended without loss, left out, warned of, or a take that cannot be used."""


@dataclass(frozen=True)
class SourceFile:
    """A file that was read: its path, the SHA-256 of its content, and its format."""

    path: str
    sha256: str
    format: str


def command_source_path(sources: Sequence[SourceFile]) -> str:
    """The path of the file that holds a recording's commands: its commands file, or else its first file."""
    return next((s.path for s in sources if s.format == COMMANDS_FORMAT), sources[0].path)


@dataclass(frozen=True)
class Irregularity:
    """A fault of a recording: its kind, what became of it, how many samples it concerns, where, and an explanation."""

    kind: str
    action: Action
    count: int
    where: str
    detail: str


@dataclass(frozen=True)
class Stream:
    """Samples over time; rows are finite and times strictly increasing."""

    time_s: Floats  # (N,) seconds from the take's time zero
    values: Floats  # (N, n)

    def __len__(self) -> int:
        """The number of samples, N."""
        return len(self.time_s)

    def held_at(self, time_s: Floats) -> Floats:
        """The last values (M, n) before or at each of `time_s` (M,); the first values before the first sample."""
        rows = np.searchsorted(self.time_s, time_s, side="right") - 1
        values: Floats = self.values[np.maximum(rows, 0)]
        return values


@dataclass(frozen=True)
class Recording:
    """One take: poses, commands and further channels over time, its irregularities, and the estimate of its clock.

    Poses are those of the CoG as far as the vehicle file states how the tracked body is mounted on the car. Time stamps
    are as recorded, but for what the vehicle file's [clock] states: an offset of the commands' clock, and that commands
    are old when they are logged.  What is only estimated is only reported.
    """

    name: str
    sources: tuple[SourceFile, ...]
    poses: Stream  # x m, y m, yaw rad (continuous)
    commands: Stream  # u_s rad, u_m m/s; a value holds until the next row
    rate_hz: float  # nominal pose rate
    hold_s: float  # longest time a command holds
    breaks_s: tuple[float, ...] = ()  # pose times at which a new segment begins
    channels: Mapping[str, Stream] = field(default_factory=dict)
    irregularities: tuple[Irregularity, ...] = ()
    clock: ClockEstimate = ClockEstimate(reason="not estimated")  # noqa: RUF009  # it is immutable

    @property
    def driven(self) -> Stream:
        """Commands with the brake: u_s, u_m and the brake share (0 without its channel), at the times of either."""
        if BRAKE_CHANNEL not in self.channels:
            return Stream(self.commands.time_s, np.column_stack([self.commands.values, np.zeros(len(self.commands))]))
        brake = self.channels[BRAKE_CHANNEL]
        time_s = np.union1d(self.commands.time_s, brake.time_s[brake.time_s >= self.commands.time_s[0]])
        return Stream(time_s, np.column_stack([self.commands.held_at(time_s), brake.held_at(time_s)]))

    @property
    def duration_s(self) -> float:
        """The time (s) from the first to the last pose."""
        return float(self.poses.time_s[-1] - self.poses.time_s[0])

    @property
    def sha256(self) -> str:
        """The SHA-256 digests of all source files, joined by "+"."""
        return "+".join(s.sha256 for s in self.sources)

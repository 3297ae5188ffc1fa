"""`Recording`: a pose stream and a command stream, where they came from, and what was odd about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from bcid.aliases import Floats


@dataclass(frozen=True)
class Source:
    """A file that was read."""

    path: str
    sha256: str
    format: str


COMMANDS = "commands-csv"


def log_of(sources: Sequence[Source]) -> str:
    """The file of the commands and further channels: the one beside a Motive export, or the recording's first."""
    return next((s.path for s in sources if s.format == COMMANDS), sources[0].path)


@dataclass(frozen=True)
class Irregularity:
    """Something odd that was found: fixed (and how often) or left in and warned about."""

    kind: str
    action: Literal["fixed", "excluded", "warning"]
    count: int
    where: str
    detail: str


@dataclass(frozen=True)
class Stream:
    """Samples over time; rows are finite and times strictly increasing."""

    time_s: Floats  # (N,) seconds from the take's time zero
    values: Floats  # (N, n)

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class Recording:
    """One take.

    Poses are those of the CoG as far as the vehicle file says how the tracked body sits on the car.
    Time stamps are as recorded: an estimated clock offset is reported, never applied, unless the
    vehicle file states one.
    """

    name: str
    sources: tuple[Source, ...]
    poses: Stream  # x m, y m, yaw rad (continuous)
    commands: Stream  # u_s rad, u_m m/s; a value holds until the next row
    rate_hz: float  # nominal pose rate
    hold_s: float  # longest time a command holds
    breaks_s: tuple[float, ...] = ()  # a new stretch begins at these pose times
    channels: Mapping[str, Stream] = field(default_factory=dict)
    irregularities: tuple[Irregularity, ...] = ()
    clock: Mapping[str, Any] = field(default_factory=dict)  # offset, drift, their intervals

    @property
    def duration_s(self) -> float:
        """From the first to the last pose."""
        return float(self.poses.time_s[-1] - self.poses.time_s[0])

    @property
    def sha256(self) -> str:
        """The digests of all sources, joined."""
        return "+".join(s.sha256 for s in self.sources)

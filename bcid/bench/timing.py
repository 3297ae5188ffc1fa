"""Two ways of doing the same thing, timed in turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

LEAST_S = 2e-3  # that a turn lasts: shorter work is repeated within it
Work = Callable[[], Any]


@dataclass(frozen=True)
class Row:
    """One hot path beside one peer."""

    path: str
    peer: str
    ours_ms: float  # medians over the turns
    peer_ms: float
    goal: float | None  # the least ratio wanted
    difference: float | None  # largest one of the results; None where they are not the same thing
    tolerated: float | None = None  # of the difference, where a faster way may not be a worse one

    @property
    def ratio(self) -> float:
        """How many times as long the peer takes."""
        return self.peer_ms / self.ours_ms

    @property
    def missed(self) -> bool:
        """Whether the ratio falls short of its goal, or the result does."""
        worse = None not in (self.tolerated, self.difference) and self.difference > self.tolerated  # type: ignore[operator]
        return worse or (self.goal is not None and self.ratio < self.goal)

    def as_json(self) -> dict[str, Any]:
        """See contracts, `bcid.bench/1`."""
        return asdict(self) | {"ratio": self.ratio, "missed": self.missed}


def compared(
    path: str, ours: Work, peers: Mapping[str, tuple[Work, float | None, float | None]], repeats: int
) -> list[Row]:
    """A row for each peer, which is (work, goal, how far its result is from ours): all take turns, warmed up."""
    works = {"": ours} | {name: work for name, (work, _, _) in peers.items()}
    times: dict[str, list[float]] = {name: [] for name in works}
    inner = {name: _inner(work) for name, work in works.items()}
    for _ in range(repeats):
        for name, work in works.items():
            begin = time.perf_counter()
            for _ in range(inner[name]):
                work()
            times[name].append((time.perf_counter() - begin) / inner[name])
    ms = {name: 1e3 * float(np.median(t)) for name, t in times.items()}
    return [Row(path, name, ms[""], ms[name], goal, difference) for name, (_, goal, difference) in peers.items()]


def _inner(work: Work) -> int:
    """How often the work is done in one turn; the first call warms it up."""
    work()
    begin = time.perf_counter()
    work()
    return max(1, round(LEAST_S / max(time.perf_counter() - begin, 1e-7)))

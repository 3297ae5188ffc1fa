"""Several ways of doing one thing, timed in turns."""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

# Shortest duration of a turn (s): shorter work is repeated within it.
MIN_TURN_S = 2e-3
Work = Callable[[], Any]


@dataclass(frozen=True)
class Timing:
    """The time of one hot path beside that of one peer."""

    path: str
    peer: str
    ours_ms: float  # medians over the turns
    peer_ms: float
    goal: float | None  # lowest ratio wanted
    difference: float | None  # largest difference of the results; None where they are not comparable
    tolerated: float | None = None  # largest difference accepted, where faster must not be worse

    @property
    def ratio(self) -> float:
        """The peer's time as a multiple of ours."""
        return self.peer_ms / self.ours_ms

    @property
    def missed(self) -> bool:
        """Whether the ratio is below its goal, or our result is worse than tolerated."""
        worse = None not in (self.tolerated, self.difference) and self.difference > self.tolerated  # type: ignore[operator]
        return worse or (self.goal is not None and self.ratio < self.goal)

    def as_json(self) -> dict[str, Any]:
        """The timing as a row of the benchmark's JSON (`bcid.bench/1`)."""
        return asdict(self) | {"ratio": self.ratio, "missed": self.missed}


def time_against_peers(
    hot_path: str, ours: Work, peers: Mapping[str, tuple[Work, float | None, float | None]], repeats: int
) -> list[Timing]:
    """Time our implementation `ours` of a hot path and those of `peers` alternately, in `repeats` turns each.

    Returns one timing for each peer, with medians over the turns.  A peer is given by its name as (work, lowest wanted
    ratio of its time to ours, largest difference of its result from ours), with None for no goal or no comparison.
    """
    works = {"": ours} | {name: work for name, (work, _, _) in peers.items()}
    times: dict[str, list[float]] = {name: [] for name in works}
    per_turn = {name: _repeats_per_turn(work) for name, work in works.items()}
    for _ in range(repeats):
        for name, work in works.items():
            begin = time.perf_counter()
            for _ in range(per_turn[name]):
                work()
            times[name].append((time.perf_counter() - begin) / per_turn[name])
    ms = {name: 1e3 * float(np.median(t)) for name, t in times.items()}
    return [Timing(hot_path, name, ms[""], ms[name], goal, difference) for name, (_, goal, difference) in peers.items()]


def _repeats_per_turn(work: Work) -> int:
    """Number of calls of `work`, at least 1, with which one timed turn lasts some MIN_TURN_S (s).

    It is estimated from the second of two calls; the first only warms up.
    """
    work()
    begin = time.perf_counter()
    work()
    return max(1, round(MIN_TURN_S / max(time.perf_counter() - begin, 1e-7)))

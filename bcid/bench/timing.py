"""Several ways of doing one thing, timed in turns."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

# Shortest duration of a turn (s): shorter work is repeated within it.
MIN_TURN_S = 1e-2
Work = Callable[[], Any]


class PeerMissing(RuntimeError):
    """A peer that cannot be had here; the text says why."""


@dataclass(frozen=True)
class Timing:
    """The CPU time of one hot path beside that of one peer, of all threads of the process."""

    path: str
    peer: str
    ours_ms: float  # medians over the turns
    peer_ms: float
    goal: float | None  # lowest ratio wanted
    difference: float | None  # largest difference of the results; None where they are not comparable
    tolerated: float | None = None  # largest difference accepted
    longest_ms: float | None = None  # longest time wanted of ours, on the machine of the committed figures

    @property
    def ratio(self) -> float:
        """The peer's time as a multiple of ours."""
        return self.peer_ms / self.ours_ms

    @property
    def missed(self) -> bool:
        """Whether ratio or time fall short of a goal, or the results are farther apart than tolerated."""
        apart = None not in (self.tolerated, self.difference) and not self.difference <= self.tolerated  # type: ignore[operator]
        slow = self.longest_ms is not None and self.ours_ms > self.longest_ms
        return apart or slow or (self.goal is not None and self.ratio < self.goal)

    def as_json(self) -> dict[str, Any]:
        """The timing as a row of the benchmark's JSON (`bcid.bench/1`)."""
        return asdict(self) | {"ratio": self.ratio, "missed": self.missed}


@dataclass(frozen=True)
class Skipped:
    """A peer of a hot path that was not timed, and why."""

    path: str
    peer: str
    reason: str


@dataclass(frozen=True)
class TimedPeer:
    """Another way of doing the work of a hot path."""

    # makes the call that is timed; raises `PeerMissing` where the peer cannot be had
    build: Callable[[], Work]
    # lowest wanted ratio of its time to ours
    goal: float | None = None
    # largest accepted difference of its result from ours; None where the two do not compute the same
    tolerated: float | None = None


def require(*modules: str) -> None:
    """Raise `PeerMissing` where one of the `modules` is not installed."""
    absent = [name for name in modules if find_spec(name) is None]
    if absent:
        raise PeerMissing(f"{', '.join(absent)} not installed (pip install -e '.[bench,export]')")


def time_against_peers(
    hot_path: str, ours: Work, peers: Mapping[str, TimedPeer], repeats: int, longest_ms: float | None = None
) -> Iterator[Timing | Skipped]:
    """Time our implementation `ours` of a hot path and those of `peers` alternately, in `repeats` turns each.

    Yields a timing for each peer, with medians of CPU time over the turns, or why it was skipped.  `longest_ms` is the
    longest time wanted of ours.
    """
    works, result = {"": ours}, ours()
    differences: dict[str, float | None] = {}
    for name, peer in peers.items():
        try:
            works[name] = peer.build()
        except PeerMissing as missing:
            yield Skipped(hot_path, name, str(missing))
            continue
        differences[name] = None if peer.tolerated is None else largest_difference(works[name](), result)
    times: dict[str, list[float]] = {name: [] for name in works}
    per_turn = {name: _repeats_per_turn(work) for name, work in works.items()}
    for _ in range(repeats):
        for name, work in works.items():
            # a short work finds the memory as it leaves it, not as the one before it did
            if per_turn[name] > 1:
                work()
            begin = time.process_time()
            for _ in range(per_turn[name]):
                work()
            times[name].append((time.process_time() - begin) / per_turn[name])
    ms = {name: 1e3 * float(np.median(t)) for name, t in times.items()}
    for name, difference in differences.items():
        peer = peers[name]
        yield Timing(hot_path, name, ms[""], ms[name], peer.goal, difference, peer.tolerated, longest_ms)


def largest_difference(a: Any, b: Any) -> float:
    """The largest absolute difference of two arrays of numbers of one shape; infinite where only one has a number."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if a.shape != b.shape or (np.isnan(a) != np.isnan(b)).any():
        return np.inf
    return float(np.nanmax(np.abs(a - b)))


def _repeats_per_turn(work: Work) -> int:
    """Number of calls of `work`, at least 1, with which one timed turn lasts some MIN_TURN_S (s).

    It is estimated from the second of two calls; the first only warms up.
    """
    work()
    begin = time.process_time()
    work()
    return max(1, round(MIN_TURN_S / max(time.process_time() - begin, 1e-7)))

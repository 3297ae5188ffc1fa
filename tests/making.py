"""Recordings made for single tests, and what several tests do."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from bcid.execution.pool import Raised
from bcid.files import source_code
from bcid.simulation.drive import Drive
from bcid.simulation.writing import write_motive_take


def clear_source_caches() -> None:
    """Forget digests and imports of the package, so that edited sources are read anew."""
    for cached in (source_code._module_path, source_code._read_module):
        cached.cache_clear()
    for digest in (source_code.digest_with_imports, source_code.stage_code):
        digest.cache_clear()


def circling_take(folder: Path, name: str = "circle", seconds: float = 20.0, rate_hz: float = 60.0) -> Path:
    """A Motive export, with its commands, of a car that circles at 1 m/s and 0.6 rad/s."""
    frame = np.arange(int(seconds * rate_hz) + 1)
    yaw = 0.6 * frame / rate_hz
    pose = np.column_stack([np.sin(yaw) / 0.6, (1.0 - np.cos(yaw)) / 0.6, yaw])
    command_time = np.arange(int(seconds * 20)) / 20.0
    command = np.tile([0.5, 1.2], (len(command_time), 1))
    path = folder / f"{name}.csv"
    write_motive_take(path, Drive(command_time, command, frame, pose, np.zeros((1, 8))), rate_hz, 0)
    return path


class ThreadPool:
    """Threads in place of processes, which share what stands in for slow work."""

    def __init__(self, workers: int) -> None:
        self.size = workers
        self._threads, self._running = ThreadPoolExecutor(workers), dict[Future[Any], Any]()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._threads.shutdown()

    @property
    def free(self) -> int:
        return self.size - len(self._running)

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        self._running[self._threads.submit(call)] = key

    def next_results(self) -> list[tuple[Any, Any]]:
        done = wait(self._running, return_when=FIRST_COMPLETED).done
        return [(self._running.pop(f), Raised(error) if (error := f.exception()) else f.result()) for f in done]

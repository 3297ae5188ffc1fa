"""A Dask cluster as a place where calls are done: a scheduler and workers, on this machine or on others.

A worker that is lost costs its call only, which the scheduler gives to another one.  Workers see the same files under
the same paths, and have the same version of this package.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bcid.errors import UsageError
from bcid.execution.limits import LIMITS
from bcid.execution.pool import Died, Raised, use_one_thread
from bcid.libraries import require_library

CONNECT_WITHIN_S = 5
"""Seconds until a scheduler that does not answer is given up."""


class Cluster:
    """The workers of the Dask scheduler at an address, such as "tcp://127.0.0.1:8786"."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._client: Any = None
        self._running: dict[Any, Any] = {}

    def __enter__(self) -> Self:
        """Connect to the scheduler.

        Raises:
            UsageError: it does not answer, it has no workers, or these run other code of this package.
            LibraryMissing: Dask is not installed.
        """
        require_library("distributed", "--dask")
        import distributed

        try:
            make: Any = distributed.Client
            self._client = make(self.address, timeout=CONNECT_WITHIN_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise UsageError(
                f"--dask {self.address}: no scheduler answers: {error}\n"
                "  next: start one with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`"
            ) from None
        self._check_workers()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take back what has not ended, and leave the cluster as it was."""
        self._client.cancel(list(self._running), force=True)
        self._client.close()
        self._running = {}

    def _check_workers(self) -> None:
        """Refuse a cluster without workers, and one whose workers would make other artifacts than this process."""
        digests = self._client.run(package_digest)
        if not digests:
            raise UsageError(
                f"--dask {self.address}: the scheduler has no workers\n"
                f"  next: start some with `dask worker {self.address} --nthreads 1`"
            )
        others = sorted(worker for worker, digest in digests.items() if digest != package_digest())
        if others:
            raise UsageError(
                f"--dask {self.address}: {', '.join(others)} run other code of bcid than this process\n"
                "  next: install the same version everywhere, and start the workers anew"
            )

    @property
    def size(self) -> int:
        """How many calls can be done at the same time: the threads of all workers that are there now."""
        return sum(self._client.nthreads().values())

    @property
    def free(self) -> int:
        """How many more calls can be done at the same time."""
        return self.size - len(self._running)

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        """Let a worker do `call`, whose result will be given under `key`."""
        future = self._client.submit(_do_call, call, pure=False, retries=LIMITS.max_deaths)
        self._running[future] = key

    def next_results(self) -> list[tuple[Any, Any]]:
        """Wait until a call or more have ended; their keys and results, `Raised` errors or `Died`."""
        import distributed

        wait: Any = distributed.wait
        with self._client.as_current():
            done = wait(list(self._running), return_when="FIRST_COMPLETED").done
        return [(self._running.pop(future), self._take_result(future)) for future in done]

    @staticmethod
    def _take_result(future: Any) -> Any:
        """What an ended call gave."""
        from distributed import KilledWorker

        if future.status == "finished":
            return future.result()
        error = future.exception()
        return Died(None) if isinstance(error, KilledWorker) else Raised(error)


def package_digest() -> str:
    """A digest of all Python files of this package, where this is called."""
    import bcid

    home, digest = Path(bcid.__file__).parent, hashlib.sha256()
    for path in sorted(home.rglob("*.py")):
        digest.update(path.relative_to(home).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _do_call(call: Callable[[], Any]) -> Any:
    """The result of a call, done in one thread; an error that it raised is one, too, so that it is not tried again."""
    use_one_thread()
    try:
        return call()
    except Exception as error:  # it is raised where the result is asked for
        return Raised(error)

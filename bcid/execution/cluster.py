"""A Dask cluster as a place where calls are done: a scheduler and workers, on this machine or on others.

A worker that is lost costs its call only, which the scheduler gives to another one, until more workers have died of
that call than its setting `allowed-failures` says (3, so that the fourth is the last).  A call that runs is not
interrupted: after Ctrl-C, or an error here, workers finish the calls that they are at, and hold the locks of these
until then.  Workers see the same files under the same paths, have the same version of this package, and one thread
each, as a call has a process to itself.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import hashlib
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bcid.errors import BcidError, UsageError
from bcid.execution.limits import LIMITS
from bcid.execution.pool import Died, Raised, use_one_thread
from bcid.libraries import require_library

CANCELLED = (concurrent.futures.CancelledError, asyncio.CancelledError)
"""What is raised of calls that a scheduler drops; the second is no `Exception`."""


class ClusterLost(BcidError):
    """The scheduler of a cluster is gone, or all its workers are, while calls had not ended."""


class Cluster:
    """The workers of the Dask scheduler at an address, such as "tcp://127.0.0.1:8786"."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._client: Any = None
        self._running: dict[Any, Any] = {}
        self._checked = set[str]()

    def __enter__(self) -> Self:
        """Connect to the scheduler.

        Raises:
            UsageError: it does not answer, it has no workers, these run other code of this package, or several threads.
            LibraryMissing: Dask is not installed.
        """
        require_library("distributed", "--dask")
        import distributed

        try:
            make: Any = distributed.Client
            self._client = make(self.address, timeout=LIMITS.connect_within_s, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise UsageError(
                f"--dask {self.address}: no scheduler answers: {error}\n"
                "  next: start one with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`"
            ) from None
        try:
            self._check_workers()
        except BaseException:
            self._client.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take back what has not begun; what runs on workers ends there by itself, and nobody reads its result."""
        from distributed.utils import silence_logging_cmgr

        # of a lost scheduler Dask would print its own traceback beside the error that is raised
        with silence_logging_cmgr(logging.CRITICAL):
            if self._client.status == "running":
                self._client.cancel(list(self._running), force=True)
            self._client.close()
        self._running = {}

    def _check_workers(self) -> None:
        """Wait for workers to be there, and refuse those that are unfit."""
        try:  # they may be starting
            self._client.wait_for_workers(1, timeout=LIMITS.connect_within_s)
        except TimeoutError:
            raise UsageError(
                f"--dask {self.address}: the scheduler has no workers\n"
                f"  next: start some with `dask worker {self.address} --nthreads 1`"
            ) from None
        self._refuse_unfit(self._client.nthreads())

    @property
    def size(self) -> int:
        """How many calls can be done at the same time: the workers that are there now, of one thread each.

        Raises:
            UsageError: a worker that came later has several threads, or runs other code of this package.
            ClusterLost: the scheduler is gone.
        """
        with self._tell_what_is_lost():
            threads: dict[str, int] = self._client.nthreads()
            self._refuse_unfit(threads)
        return len(threads)

    def _refuse_unfit(self, threads: dict[str, int]) -> None:
        """Raise a UsageError if a worker that was not there before has several threads, or runs other code.

        In several threads calls would share one process, and other code makes other artifacts than this process.
        """
        new = sorted(set(threads) - self._checked)
        if not new:
            return
        several = sorted(worker for worker, count in threads.items() if count > 1)
        if several:
            raise UsageError(
                f"--dask {self.address}: {', '.join(several)}: several threads, where each log needs its own process\n"
                f"  next: start workers with `dask worker {self.address} --nthreads 1 --nworkers N`, one for each core"
            )
        answers = self._client.run(package_digest, workers=new, on_error="return")
        # one that is gone again cannot be asked; an error of one that is there is that of a worker without this package
        there = self._client.nthreads()
        digests = {worker: answer for worker, answer in answers.items() if worker in there}
        own = package_digest()
        others = sorted(worker for worker, digest in digests.items() if digest != own)
        if others:
            raise UsageError(
                f"--dask {self.address}: {', '.join(others)} run other code of bcid than this process\n"
                "  next: install the same version everywhere, and start the workers anew"
            )
        self._checked |= set(digests)

    @property
    def free(self) -> int:
        """How many more calls can be done at the same time, which the scheduler is asked.

        It is one at least where none runs: that call then waits for a worker that is being started anew.
        """
        return max(self.size - len(self._running), 0 if self._running else 1)

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        """Let a worker do `call`, whose result will be given under `key`."""
        with self._tell_what_is_lost():
            future = self._client.submit(_do_call, call, pure=False)
        self._running[future] = key

    def next_results(self) -> list[tuple[Any, Any]]:
        """Wait until a call or more have ended; their keys and results, `Raised` errors or `Died`.

        Raises:
            ClusterLost: the scheduler is gone, or there has been no worker for `LIMITS.without_workers_s`.
        """
        seen = time.monotonic()
        with self._tell_what_is_lost():
            while not (ended := self._wait_a_while()):
                if self._client.nthreads():
                    seen = time.monotonic()
                elif time.monotonic() > seen + LIMITS.without_workers_s:
                    raise ClusterLost(
                        f"--dask {self.address}: no worker is left: they were stopped, or died of what they did\n"
                        f"  next: look into their logs, start some with `dask worker {self.address} --nthreads 1`, and "
                        "repeat the command"
                    )
            return [(self._running.pop(future), self._take_result(future)) for future in ended]

    def _wait_a_while(self) -> list[Any]:
        """Calls that have ended, at the latest after `LIMITS.look_every_s`: then there may be none."""
        import distributed

        wait: Any = distributed.wait
        with self._client.as_current():
            try:
                done = wait(list(self._running), timeout=LIMITS.look_every_s, return_when="FIRST_COMPLETED").done
            except TimeoutError:
                return []
        # the worker of a lost result died before it was fetched, and another one makes it again
        return [future for future in done if future.status != "lost"]

    @staticmethod
    def _take_result(future: Any) -> Any:
        """What an ended call gave."""
        from distributed import KilledWorker

        if future.status == "finished":
            return future.result()
        error = future.exception()
        return Died(None, error.allowed_failures + 1) if isinstance(error, KilledWorker) else Raised(error)

    @contextmanager
    def _tell_what_is_lost(self) -> Iterator[None]:
        """Context in which Dask's errors of a scheduler that is gone, or that dropped calls, are a `ClusterLost`."""
        try:
            yield
        except BcidError:
            raise
        except (Exception, *CANCELLED) as error:
            gone = self._client.status != "running"  # then Dask raises what it happens to meet, of any class
            if not gone and not isinstance(error, (OSError, *CANCELLED)):
                raise
            cause = "is gone" if gone or isinstance(error, OSError) else "was restarted, or dropped calls when told to"
            raise ClusterLost(
                f"--dask {self.address}: the scheduler {cause} before all was done\n"
                "  next: see that it runs and has workers, and repeat the command"
            ) from None


@cache
def package_digest() -> str:
    """A digest of all Python files of this package, as they were when this process was first asked.

    A worker is asked before it does anything, and then knows what it has loaded: of files that change later, as where
    somebody pulls into the checkout that workers run, it would tell a digest of code that it does not run.
    """
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

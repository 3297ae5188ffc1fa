"""Jobs done one after the other or several at a time, and their results as they end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Any, Protocol, TypeVar

from bcid.errors import BcidError
from bcid.execution.limits import LIMITS
from bcid.execution.pool import Died, Raised, WorkerPool

Job = TypeVar("Job")
Result = TypeVar("Result")


class ProcessLost(BcidError):
    """The process that did a job died each time that it was tried: it ran out of memory, or was killed."""


class Pool(Protocol):
    """Where calls are done: `WorkerPool`, or a cluster."""

    @property
    def size(self) -> int:
        """How many calls can be done at the same time."""

    @property
    def free(self) -> int:
        """How many more calls can be done at the same time; on a cluster this asks its scheduler."""

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        """Let `call` be done; its result will be given under `key`."""

    def next_results(self) -> list[tuple[Any, Any]]:
        """Wait until a call or more have ended; their keys and results, `Raised` errors or `Died`."""


Workers = int | AbstractContextManager[Pool]
"""How many processes of this machine do jobs, or the cluster that does them."""


def run_jobs(
    jobs: Iterable[Job], prepare: Callable[[Job], Callable[[], Result] | None], workers: Workers,
    lost: Callable[[Job], Result] | None = None,
) -> Iterator[tuple[Job, Result]]:  # fmt: skip
    """Run jobs in `workers` processes, in this process if it is 1, or on a cluster; yield (job, result) as each ends.

    `prepare(job)` returns the function that does a job, or None while the job may not begin (for example before
    another has ended).  Several processes ask again after every result.  Jobs begin in their order, so a job must
    come after those that it needs; jobs that still may not begin when no job runs are dropped.  A job whose process
    dies is done once more; when `LIMITS.max_deaths` processes have died of it, its result is `lost(job)`.

    Raises:
        ProcessLost: the process of a job died so often, and `lost` is not given.
    """
    if not isinstance(workers, int):
        yield from run_jobs_in(workers, jobs, prepare, lost)
        return
    if workers <= 1:
        for job in jobs:
            if (call := prepare(job)) is not None:
                yield job, call()
        return
    yield from run_jobs_in(make_pool(workers), jobs, prepare, lost)


def make_pool(workers: int) -> AbstractContextManager[Pool]:
    """Processes of this machine."""
    return WorkerPool(workers)


def run_jobs_in(
    entered: AbstractContextManager[Pool], jobs: Iterable[Job], prepare: Callable[[Job], Callable[[], Result] | None],
    lost: Callable[[Job], Result] | None = None,
) -> Iterator[tuple[Job, Result]]:  # fmt: skip
    """Run jobs as `run_jobs` does, in a pool that is entered and left here."""
    waiting, running, deaths = list(enumerate(jobs)), dict[int, Job](), Counter[int]()
    with entered as pool:
        while True:
            waiting = _begin_jobs(pool, waiting, prepare, running)
            if not running:
                return
            for number, result in pool.next_results():
                job = running.pop(number)
                if isinstance(result, Raised):
                    raise result.error
                if not isinstance(result, Died):
                    yield job, result
                    continue
                deaths[number] += result.deaths
                if deaths[number] < LIMITS.max_deaths:
                    waiting.insert(0, (number, job))
                elif lost is not None:
                    yield job, lost(job)
                else:
                    code = "" if result.code is None else f" (exit code {result.code})"
                    raise ProcessLost(
                        f"{job}: its process died {deaths[number]} times{code}, out of memory or killed\n"
                        "  next: give it fewer --workers, or look into the system's log"
                    )


def _begin_jobs(
    pool: Pool, waiting: list[tuple[int, Job]], prepare: Callable[[Job], Callable[[], Result] | None],
    running: dict[int, Job],
) -> list[tuple[int, Job]]:  # fmt: skip
    """Begin as many waiting jobs as there are free places, which adds them to `running`; the others still wait.

    The pool is asked once, and no job is looked at when all places are taken, so that many jobs cost no more each.
    """
    free, left = pool.free, list[tuple[int, Job]]()
    for place, (number, job) in enumerate(waiting):
        if free <= 0:
            return left + waiting[place:]
        if (call := prepare(job)) is None:
            left.append((number, job))
            continue
        running[number] = job
        pool.submit(number, call)
        free -= 1
    return left

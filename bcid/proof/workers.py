"""Jobs run in several processes, or in this one, and their results as they end."""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from types import TracebackType
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_jobs(
    jobs: Iterable[Job], prepare: Callable[[Job], Callable[[], Result] | None], workers: int
) -> Iterator[tuple[Job, Result]]:
    """Run jobs in `workers` processes, or in this process if `workers` is 1; yield (job, result) as each ends.

    `prepare(job)` returns the function that does a job, or None while the job may not begin (for example before
    another has ended).  Several processes ask again after every result.  Jobs begin in their order, so a job must
    come after those that it needs; jobs that still may not begin when no job runs are dropped.
    """
    waiting, running = list(jobs), dict[Future[Result], Job]()
    if workers <= 1:
        for job in waiting:
            if (call := prepare(job)) is not None:
                yield job, call()
        return
    with process_pool(workers) as pool:
        while True:
            for job in list(waiting):
                if len(running) < workers and (call := prepare(job)) is not None:
                    waiting.remove(job)
                    running[pool.submit(call)] = job
            if not running:
                return
            for ended in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(ended), ended.result()


class _WorkerPool(ProcessPoolExecutor):
    """A pool whose processes end at once after an interruption, instead of finishing their jobs."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        """Wait for the processes to end; Ctrl-C, of which only this process is told, ends them."""
        if kind is not None and not issubclass(kind, Exception):
            for child in active_children():
                child.terminate()
        return super().__exit__(kind, error, trace)


def process_pool(workers: int) -> ProcessPoolExecutor:
    """Return a pool of `workers` processes of one thread each, which end when this process ends.

    They are started by "spawn", since OpenMP does not survive a fork.
    """
    return _WorkerPool(workers, mp_context=get_context("spawn"), initializer=_prepare_worker)


def _prepare_worker() -> None:
    """Initialise a worker process: one thread, as the workers share the cores, and an end when its parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import numba
    from threadpoolctl import threadpool_limits

    Thread(target=_exit_with_parent, daemon=True).start()
    numba.set_num_threads(1)
    threadpool_limits(1)


def _exit_with_parent() -> None:
    """Wait, in a thread, for the parent process to end; then exit this worker at once, as nobody reads its results."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

"""Jobs run in several processes, or in this one, and their results as they end."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_jobs(
    jobs: Iterable[Job], prepare: Callable[[Job], Callable[[], Result] | None], workers: int
) -> Iterator[tuple[Job, Result]]:
    """Run jobs in `workers` processes, or in this one, and yield each with its result as soon as it ends.

    `prepare(job)` returns the call that does a job, or None as long as the job may not begin; several processes ask it
    again after every result.  Jobs begin in their order, so that each stands after those it waits for; jobs that may
    not begin when nothing runs any more are left out.
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


def process_pool(workers: int) -> ProcessPoolExecutor:
    """Return a pool of spawned processes with one thread each, which end when this process ends.

    They are spawned since OpenMP does not survive a fork.
    """
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_prepare_worker)


def _prepare_worker() -> None:
    """Limit this worker process to one thread, since workers share the cores, and end it with its parent."""
    import numba
    from threadpoolctl import threadpool_limits

    Thread(target=_exit_with_parent, daemon=True).start()
    numba.set_num_threads(1)
    threadpool_limits(1)


def _exit_with_parent() -> None:
    """Wait for the parent process to end, however it ends, and exit: nobody would read the results."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

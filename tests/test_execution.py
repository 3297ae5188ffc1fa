"""Jobs in several processes: all are done, a process that dies costs its job one try, and errors come through."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from bcid.errors import UsageError
from bcid.execution.cluster import Cluster
from bcid.execution.jobs import ProcessLost, run_jobs, run_jobs_in
from bcid.execution.limits import LIMITS
from bcid.execution.pool import Died, WorkerPool


def square(number: int) -> int:
    return number**2


def process_number() -> int:
    return os.getpid()


def die_unless_marked(mark: Path, number: int) -> int:
    """The number, unless nothing has been marked yet: then the process ends itself as the kernel would."""
    if not mark.exists():
        mark.write_text("died once", encoding="utf-8")
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die() -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def fail() -> int:
    raise ValueError("the job says so")


def unsendable() -> Callable[[], int]:
    return lambda: 0


def unknown_elsewhere() -> type:
    """A class that cannot be found by its name, so that pickle refuses it."""
    return type("Nowhere", (), {})


@pytest.mark.parametrize("workers", [1, 2])
def test_all_jobs_are_done(workers: int) -> None:
    done = dict(run_jobs(range(7), lambda n: partial(square, n), workers))
    assert done == {n: n**2 for n in range(7)}


def test_jobs_wait_for_those_that_they_need() -> None:
    done: list[int] = []

    def prepare(number: int) -> Callable[[], int] | None:
        return partial(square, number) if number == 0 or 0 in done else None

    for number, _ in run_jobs(range(4), prepare, 2):
        done.append(number)
    assert done[0] == 0
    assert sorted(done) == [0, 1, 2, 3]


def test_jobs_that_may_never_begin_are_dropped() -> None:
    assert list(run_jobs(range(3), lambda n: partial(square, n) if n < 2 else None, 2)) in (
        [(0, 0), (1, 1)],
        [(1, 1), (0, 0)],
    )


def test_a_process_that_dies_costs_its_job_one_try(tmp_path: Path) -> None:
    jobs = {n: partial(die_unless_marked, tmp_path / "mark", n) if n == 2 else partial(square, n) for n in range(5)}
    done = dict(run_jobs(jobs, jobs.__getitem__, 2))
    assert done == {0: 0, 1: 1, 2: 2, 3: 9, 4: 16}


def test_a_job_that_kills_each_process_is_given_up() -> None:
    jobs = {0: die, 1: partial(square, 3)}
    done = dict(run_jobs(jobs, jobs.__getitem__, 2, lost=lambda job: -1))
    assert done == {0: -1, 1: 9}
    with pytest.raises(ProcessLost, match=rf"died {LIMITS.max_deaths} times"):
        list(run_jobs([0], jobs.__getitem__, 2))


def test_an_error_in_another_process_is_raised_here() -> None:
    with pytest.raises(ValueError, match="the job says so"):
        list(run_jobs([0], lambda n: fail, 2))


def test_what_cannot_be_sent_is_said() -> None:
    for call in (unsendable, unknown_elsewhere):
        with pytest.raises(RuntimeError, match="cannot be sent"):
            list(run_jobs([0], lambda n, call=call: call, 2))


def test_the_same_job_twice_is_done_twice() -> None:
    job = 3
    assert list(run_jobs([job, job], lambda n: partial(square, n), 2)) == [(3, 9), (3, 9)]


def test_processes_are_kept_from_one_call_to_the_next() -> None:
    with WorkerPool(1) as pool:
        numbers = set()
        for key in range(3):
            pool.submit(key, process_number)
            ((found, number),) = pool.next_results()
            assert found == key
            numbers.add(number)
    assert len(numbers) == 1
    assert numbers != {os.getpid()}


def test_a_process_that_died_while_it_was_idle_is_replaced() -> None:
    with WorkerPool(1) as pool:
        pool.submit(0, process_number)
        ((_, number),) = pool.next_results()
        os.kill(number, signal.SIGKILL)
        time.sleep(0.2)
        found = None
        while not isinstance(found, int):  # a call that meets the dead process is done once more, as run_jobs does
            pool.submit(1, process_number)
            ((_, found),) = pool.next_results()
            assert isinstance(found, int | Died)
        assert found != number


def test_a_cluster_does_jobs_and_a_killed_worker_changes_nothing(scheduler: str, tmp_path: Path) -> None:
    jobs = {n: partial(die_unless_marked, tmp_path / "mark", n) if n == 1 else partial(square, n) for n in range(6)}
    done = dict(run_jobs_in(Cluster(scheduler), jobs, jobs.__getitem__))
    assert done == {0: 0, 1: 1, 2: 4, 3: 9, 4: 16, 5: 25}
    with pytest.raises(ValueError, match="the job says so"):
        list(run_jobs_in(Cluster(scheduler), [0], lambda n: fail))


def test_a_scheduler_that_does_not_answer_is_told() -> None:
    if find_spec("distributed") is None:
        pytest.skip("the extra fleet is not installed")
    with pytest.raises(UsageError, match="no scheduler answers"), Cluster("tcp://127.0.0.1:9"):
        pass

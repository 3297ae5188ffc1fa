"""Jobs in several processes: all are done, a process that dies costs its job one try, and errors come through."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from pickle import PicklingError
from typing import Any

import pytest
from clusters import run_cluster
from pools import FakePool

import bcid
from bcid.errors import UsageError
from bcid.execution import cluster as cluster_module
from bcid.execution.cluster import Cluster, ClusterLost, package_digest
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


def die_and_count(deaths: Path) -> int:
    """End the process as the kernel would, each time that this is tried."""
    with deaths.open("a", encoding="utf-8") as file:
        file.write("x")
    return die()


def sleep(seconds: float) -> None:
    time.sleep(seconds)


def raise_unreadable() -> None:
    raise RuntimeError("a module that is missing there")


class Unreadable:
    """What can be sent to another process, but not be put together there."""

    def __reduce__(self) -> tuple[Any, ...]:
        return raise_unreadable, ()

    def __call__(self) -> int:
        return 0


def make_unreadable() -> Unreadable:
    return Unreadable()


class CountedPool(FakePool):
    """Two places, each of whose calls is done when results are waited for; it counts how often it is asked."""

    def __init__(self) -> None:
        self.size, self.asked = 2, 0
        self._waiting: list[tuple[Any, Callable[[], Any]]] = []

    @property
    def free(self) -> int:
        self.asked += 1
        return self.size - len(self._waiting)

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        assert len(self._waiting) < self.size
        self._waiting.append((key, call))

    def next_results(self) -> list[tuple[Any, Any]]:
        key, call = self._waiting.pop(0)
        return [(key, call())]


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


def test_a_call_that_cannot_be_sent_costs_no_process() -> None:
    with WorkerPool(1) as pool:
        pool.submit(0, process_number)
        ((_, number),) = pool.next_results()
        with pytest.raises((AttributeError, TypeError, PicklingError)):
            pool.submit(1, lambda: 1)
        assert pool.free == 1
        pool.submit(2, process_number)
        assert pool.next_results() == [(2, number)]


@pytest.mark.parametrize(("call", "what"), [(Unreadable(), "call"), (make_unreadable, "result")])
def test_what_cannot_be_read_is_said_and_costs_no_process(call: Callable[[], Any], what: str) -> None:
    with pytest.raises(RuntimeError, match=rf"a {what} .*cannot be read.* a module that is missing there"):
        list(run_jobs([0], lambda n: call, 2))
    with WorkerPool(1) as pool:
        numbers = []
        for job in (process_number, call, process_number):
            pool.submit(0, job)
            numbers += [number for _, number in pool.next_results() if isinstance(number, int)]
    assert len(numbers) == 2
    assert len(set(numbers)) == 1


@pytest.mark.parametrize("count", [4, 64, 256])
def test_many_jobs_cost_no_more_questions_each(count: int) -> None:
    """Each result makes a place free, for which the pool is asked once, and one job or two are looked at."""
    pool, looked_at = CountedPool(), list[int]()

    def prepare(number: int) -> Callable[[], int]:
        looked_at.append(number)
        return partial(square, number)

    assert len(list(run_jobs_in(pool, range(count), prepare))) == count
    assert pool.asked <= count + 1
    assert looked_at == list(range(count))


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


def test_a_job_that_kills_each_worker_is_given_up_once(scheduler: str, tmp_path: Path) -> None:
    """The scheduler counts deaths by itself; the other jobs are done, though no worker is there for a while."""
    import dask

    deaths = tmp_path / "deaths"
    jobs = {0: partial(die_and_count, deaths), **{n: partial(square, n) for n in range(1, 4)}}
    done = dict(run_jobs_in(Cluster(scheduler), jobs, jobs.__getitem__, lost=lambda job: -1))
    assert done == {0: -1, 1: 1, 2: 4, 3: 9}
    allowed: int = dask.config.get("distributed.scheduler.allowed-failures")
    assert len(deaths.read_text(encoding="utf-8")) == allowed + 1
    with pytest.raises(ProcessLost, match=rf"died {allowed + 1} times, out of memory"):
        list(run_jobs_in(Cluster(scheduler), [0], jobs.__getitem__))


def test_calls_that_a_scheduler_drops_are_told(scheduler: str) -> None:
    with Cluster(scheduler) as cluster:
        cluster.submit(0, partial(sleep, 0.5))
        cluster._client.cancel(list(cluster._running), force=True)
        with pytest.raises(ClusterLost, match=r"dropped calls(.|\n)*next: "):
            cluster.next_results()


def test_a_call_that_cannot_be_read_on_a_cluster_is_said(scheduler: str) -> None:
    with pytest.raises(RuntimeError):
        list(run_jobs_in(Cluster(scheduler), [0], lambda n: Unreadable()))


def test_workers_with_several_threads_are_refused(tmp_path: Path) -> None:
    with (
        run_cluster(tmp_path, 1, "--nthreads", "2") as dask,
        pytest.raises(UsageError, match=r"several threads(.|\n)*next: .* --nthreads 1"),
        Cluster(dask.address),
    ):
        pass


class ToldClient:
    """A scheduler's client that knows workers by their answers to what code they run."""

    status = "running"

    def __init__(self, **answers: object) -> None:
        self.answers, self.asked = answers, list[list[str]]()

    def nthreads(self) -> dict[str, int]:
        return dict.fromkeys(self.answers, 1)

    def run(self, function: Callable[[], str], workers: list[str], on_error: str) -> dict[str, object]:
        self.asked.append(workers)
        return {worker: self.answers[worker] for worker in workers}


def test_a_worker_tells_the_code_that_it_has_loaded_not_what_lies_there_later(tmp_path: Path) -> None:
    """As where somebody pulls into a checkout that workers run."""
    copy = tmp_path / "bcid"
    shutil.copytree(Path(bcid.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    script = (
        "from pathlib import Path; from bcid.execution.cluster import package_digest; first = package_digest();"
        "Path('bcid/aliases.py').write_text('# other'); print(first, package_digest())"
    )
    run = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    first, later = run.stdout.split()
    assert first == later == package_digest()


THREADS_OF_LIBRARIES = """
from bcid.execution.jobs import make_pool, run_jobs_in
from threads_of_libraries import count_threads

if __name__ == "__main__":
    print([threads for _, threads in run_jobs_in(make_pool(1), [0], lambda _: count_threads)])
"""


def test_libraries_that_a_call_loads_have_one_thread(tmp_path: Path) -> None:
    """As the linear algebra that scipy brings, which is not there when a process of the pool begins."""
    (tmp_path / "threads_of_libraries.py").write_text(
        "def count_threads():\n"
        "    import scipy.linalg, threadpoolctl\n"
        "    return max(library['num_threads'] for library in threadpoolctl.threadpool_info())\n",
        encoding="utf-8",
    )
    (tmp_path / "ask.py").write_text(THREADS_OF_LIBRARIES, encoding="utf-8")
    unsaid = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    path = os.pathsep.join([str(tmp_path), str(Path(bcid.__file__).parents[1])])
    run = subprocess.run(
        [sys.executable, str(tmp_path / "ask.py")], env=unsaid | {"PYTHONPATH": path}, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert run.stdout.strip() == "[1]"


@pytest.mark.parametrize("answer", ["0" * 64, ModuleNotFoundError("bcid"), PermissionError("cluster.py")])
def test_a_worker_that_comes_later_is_asked_once_what_code_it_runs(answer: object) -> None:
    cluster = Cluster("tcp://desk:8786")
    cluster._client = client = ToldClient(first=package_digest())
    assert (cluster.size, cluster.size) == (1, 1)
    client.answers["second"] = package_digest()
    assert cluster.size == 2
    assert client.asked == [["first"], ["second"]]
    client.answers["third"] = answer
    with pytest.raises(UsageError, match=r"third run other code(.|\n)*next: install the same version"):
        _ = cluster.size


def test_a_cluster_whose_workers_are_gone_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "LIMITS", replace(LIMITS, look_every_s=0.1, without_workers_s=0.5))
    with (
        run_cluster(tmp_path, 1, "--nthreads", "1", "--no-nanny") as dask,
        pytest.raises(ClusterLost, match=r"no worker is left(.|\n)*next: "),
    ):
        list(run_jobs_in(Cluster(dask.address), [0], lambda n: die))


def test_a_scheduler_that_dies_is_told(tmp_path: Path) -> None:
    with run_cluster(tmp_path, 1, "--nthreads", "1") as dask, Cluster(dask.address) as cluster:
        cluster.submit(0, partial(sleep, 30.0))
        dask.scheduler.kill()
        with pytest.raises(ClusterLost, match=r"the scheduler is gone(.|\n)*next: "):
            cluster.next_results()
        with pytest.raises(ClusterLost, match="the scheduler is gone"):
            assert cluster.free


def test_a_scheduler_that_does_not_answer_is_told() -> None:
    if find_spec("distributed") is None:
        pytest.skip("the extra fleet is not installed")
    with pytest.raises(UsageError, match="no scheduler answers"), Cluster("tcp://127.0.0.1:9"):
        pass

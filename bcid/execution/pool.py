"""Processes of this machine that do one call after the other, and of which each may die without the others' loss."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from threading import Thread
from types import TracebackType
from typing import Any, NamedTuple, Self

from bcid.execution.limits import LIMITS

Call = Callable[[], Any]
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that say how many threads a library of linear algebra has, which it reads when it is loaded."""


class Died(NamedTuple):
    """What is there in place of a result where the process died that was to give it, or `deaths` processes in turn.

    `code` is the exit code of the last one, None where it is not known.
    """

    code: int | None
    deaths: int = 1


class Raised(NamedTuple):
    """What is there in place of a result where the call raised an error."""

    error: BaseException


class _Worker:
    """A process that does calls, and the connection by which it is given them."""

    def __init__(self) -> None:
        # by "spawn", since OpenMP does not survive a fork
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_do_calls, args=(theirs,), daemon=True)
        with _one_thread_said():
            self.process.start()
        theirs.close()

    def end(self) -> None:
        """End the process, by force if it does not."""
        self.connection.close()
        self.process.terminate()
        self.process.join(LIMITS.end_within_s)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


class WorkerPool:
    """Processes of one thread each, which end when this process ends."""

    def __init__(self, workers: int) -> None:
        """Make a pool of at most `workers` processes, each started when it is needed first."""
        self.size = workers
        self._idle: list[_Worker] = []
        self._busy: dict[_Worker, Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all processes at once, whatever they do."""
        for worker in (*self._idle, *self._busy):
            worker.end()
        self._idle, self._busy = [], {}

    @property
    def free(self) -> int:
        """How many more calls can be done at the same time."""
        return self.size - len(self._busy)

    def submit(self, key: Any, call: Call) -> None:
        """Let a free process do `call`, whose result will be given under `key`."""
        worker = self._idle.pop() if self._idle else _Worker()
        try:
            worker.connection.send(call)
        except OSError:  # it died while it was idle
            worker.end()
            worker = _Worker()
            worker.connection.send(call)
        except BaseException:  # the call cannot be sent to another process
            self._idle.append(worker)
            raise
        self._busy[worker] = key

    def next_results(self) -> list[tuple[Any, Any]]:
        """Wait until a call or more have ended; their keys and results, `Raised` errors or `Died`."""
        at = {w.connection: w for w in self._busy} | {w.process.sentinel: w for w in self._busy}
        ended = dict.fromkeys(at[ready] for ready in wait(list(at)))  # type: ignore[index]  # what was given
        return [(self._busy[worker], self._take_result(worker)) for worker in ended]

    def _take_result(self, worker: _Worker) -> Any:
        """What the ended call of a worker gave; a worker that lives is free again."""
        try:
            sent = worker.connection.recv_bytes() if worker.connection.poll() else None
        except (EOFError, OSError):
            sent = None
        del self._busy[worker]
        if sent is None:
            worker.process.join()
            code = worker.process.exitcode
            worker.end()
            return Died(code)
        self._idle.append(worker)
        try:
            return ForkingPickler.loads(sent)
        except Exception as error:  # whatever it runs when it is put together may raise anything
            return Raised(RuntimeError(f"a result of another process cannot be read: {_describe(error)}"))


@contextmanager
def _one_thread_said() -> Iterator[None]:
    """Context in which processes begin that let linear algebra use one thread, unless the variables say otherwise."""
    unsaid = [name for name in THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(unsaid, "1"))
    try:
        yield
    finally:
        for name in unsaid:
            del os.environ[name]


def _do_calls(connection: Connection) -> None:
    """Do calls as they come, in a process of its own: one thread, deaf to Ctrl-C, ending with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_exit_with_parent, daemon=True).start()
    use_one_thread()
    while True:
        try:
            sent = connection.recv_bytes()
        except (EOFError, OSError):  # the parent has ended
            return
        connection.send_bytes(_do_call(sent))


def _do_call(sent: bytes) -> bytes:
    """The result of a call, or why it has none, each as it is sent from one process to another."""
    try:
        call: Call = ForkingPickler.loads(sent)
    except Exception as error:  # imports, for example, may raise anything
        return _pack(Raised(RuntimeError(f"a call cannot be read in another process: {_describe(error)}")))
    try:
        result = call()
    except Exception as error:  # it is raised where the result is asked for
        result = Raised(error)
    try:
        return _pack(result)
    except Exception as error:  # a class may refuse to be sent in its own way
        return _pack(Raised(RuntimeError(f"a result cannot be sent to another process: {_describe(error)}")))


def _pack(result: Any) -> bytes:
    """A result as it is sent to another process."""
    return bytes(ForkingPickler.dumps(result))


def _describe(error: Exception) -> str:
    """The kind of an error, and what it says."""
    return f"{type(error).__name__}: {error}"


def use_one_thread() -> None:
    """Let compiled loops and linear algebra that is loaded use one thread, as the workers share the cores."""
    import numba
    from threadpoolctl import threadpool_limits

    numba.set_num_threads(1)
    threadpool_limits(1)


def _exit_with_parent() -> None:
    """Wait, in a thread, for the parent process to end; then exit this worker at once, as nobody reads its results."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

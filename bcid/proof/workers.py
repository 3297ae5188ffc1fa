"""Processes that answer questions side by side."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process
from threading import Thread


def pool_of(workers: int) -> ProcessPoolExecutor:
    """Processes with one thread each: they share the cores.  Spawned, since a fork takes no OpenMP with it."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_alone)


def _alone() -> None:
    import numba
    from threadpoolctl import threadpool_limits

    Thread(target=_with_parent, daemon=True).start()
    numba.set_num_threads(1)
    threadpool_limits(1)


def _with_parent() -> None:
    """End this process as soon as its parent has ended, however: nobody would read what it makes."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

"""A suite run: every case driven, diagnosed and kept, the answer beside what was said."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from bcid.errors import BcidError
from bcid.proof.asking import run_case
from bcid.proof.cases import Case
from bcid.proof.keeping import keep
from bcid.store.code import code_of

JUDGED = ("bcid.simulation.drive", "bcid.proof.asking")
"""The modules whose code, with all that they import, makes a row what it is."""


def _told(case: Case) -> dict[str, Any]:
    """The answer."""
    return {
        "case": case.name, "tier": case.tier, "answer": list(case.answer), "channel": case.channel,
        "truth": {c.effect: dict(c.parameters) for c in case.concealed}, "left_out": list(case.left_out),
        "duration_s": case.duration_s,
    }  # fmt: skip


def run_all(cases: Iterable[Case], folder: Path, workers: int, others: bool = False) -> Iterator[dict[str, Any]]:
    """Every case's row: what is in `folder` is read, the others made and kept there, each as it is done.

    What a diagnosis said is kept under the digests of what was driven and of the simulation's and the diagnosis's
    code; one that ended in an error is made again.
    """
    folder.mkdir(parents=True, exist_ok=True)
    todo = []
    for case in cases:
        row = _known(case, folder, others)
        if row is None:
            todo.append(case)
        else:
            yield {**_told(case), **row}
    if workers <= 1:
        for case in todo:
            yield {**_told(case), **_kept(case, folder, others)}
        return
    with pool_of(workers) as pool:
        running = {pool.submit(_kept, case, folder, others): case for case in todo}
        for done in as_completed(running):
            yield {**_told(running[done]), **done.result()}


def known(cases: Iterable[Case], folder: Path, others: bool = False) -> int:
    """How many cases' rows lie in `folder` already."""
    return sum(_known(case, folder, others) is not None for case in cases)


def _file(case: Case, folder: Path, others: bool) -> Path:
    modules = (*JUDGED, "bcid.proof.baselines") if others else JUDGED
    code = [code_of(m) for m in modules]
    text = repr([(c.digest, sorted(c.packages.items())) for c in code])
    return folder / f"{case.digest()}.{hashlib.sha256(text.encode()).hexdigest()[:12]}.json"


def _known(case: Case, folder: Path, others: bool) -> dict[str, Any] | None:
    try:
        row: dict[str, Any] = json.loads(_file(case, folder, others).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return None if "error" in row else row


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


def _kept(case: Case, folder: Path, others: bool) -> dict[str, Any]:
    try:
        row = run_case(case, others)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError, BcidError) as error:
        row = {"error": repr(error)}
    keep(row, _file(case, folder, others))
    return row

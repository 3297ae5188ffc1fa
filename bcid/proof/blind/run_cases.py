"""A suite run: every case driven, diagnosed and kept, the answer beside what was said."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from bcid.proof.blind.ask import answered
from bcid.proof.blind.cases import Case
from bcid.proof.rows import digest_of, keep, kept

JUDGED = ("bcid.simulation.drive", "bcid.proof.blind.ask")
"""The modules whose code, with all that they import, makes a row what it is."""


def truth_of(case: Case) -> dict[str, Any]:
    """What is concealed, as it is scored."""
    return {
        "case": case.name, "tier": case.tier, "answer": list(case.answer), "channel": case.channel,
        "truth": {c.effect: dict(c.parameters) for c in case.concealed}, "left_out": list(case.left_out),
        "duration_s": case.duration_s,
    }  # fmt: skip


def run_all(
    cases: Iterable[Case], folder: Path, workers: int, others: bool = False, minutes: float | None = None
) -> Iterator[dict[str, Any]]:
    """Every case's row: what is in `folder` is read, the others made and kept there, each as it is done.

    What a diagnosis said is kept under the digests of what was driven and of the simulation's and the diagnosis's
    code; one that ended in an error is made again, if there is time.  Cases are run in an order drawn by lot, so that a
    run which ends after so many `minutes`, with what it has begun, has run a fair part of every tier.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows, code, todo = kept(folder), code_of_rows(others), list[Case]()
    for case in cases:
        row = _known(rows, case, code)
        if row is None:
            todo.append(case)
        else:
            yield {**truth_of(case), **row}
    todo.sort(key=lambda case: case.digest())
    end = np.inf if minutes is None else time.monotonic() + 60.0 * minutes
    waiting = iter(todo)
    for case, row in _made(waiting, code, folder, workers, others, end):
        yield {**truth_of(case), **row}
    for case in waiting:
        if _key(case, code) in rows:  # an error that there was no time to ask again
            yield {**truth_of(case), **rows[_key(case, code)]}


def _made(
    waiting: Iterator[Case], code: str, folder: Path, workers: int, others: bool, end: float
) -> Iterator[tuple[Case, dict[str, Any]]]:
    """The rows of the cases that are `waiting`, each as it is done, until it is `end` on the clock."""
    if workers <= 1:
        while time.monotonic() < end and (case := next(waiting, None)) is not None:
            yield case, _run(case, code, folder, others)
        return
    with pool_of(workers) as pool:
        running = dict[Future[dict[str, Any]], Case]()
        while True:
            free = workers - len(running) if time.monotonic() < end else 0
            running |= {pool.submit(_run, case, code, folder, others): case for case in islice(waiting, free)}
            if not running:
                return
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(done), done.result()


def asked_before(cases: Iterable[Case], folder: Path) -> int:
    """How many of the cases have rows in `folder`, by whatever code: what was said of them was known before."""
    there = {key.partition(".")[0] for key in kept(folder)}
    return sum(case.digest() in there for case in cases)


def code_of_rows(others: bool) -> str:
    """The digest of the code that makes a row, of `others` methods as well, and of the libraries' versions."""
    return digest_of((*JUDGED, "bcid.proof.baselines") if others else JUDGED)


def _key(case: Case, code: str) -> str:
    return f"{case.digest()}.{code}"


def _known(rows: Mapping[str, dict[str, Any]], case: Case, code: str) -> dict[str, Any] | None:
    row = rows.get(_key(case, code))
    return None if row is None or "error" in row else row


def run_case(case: Case, others: bool = False) -> dict[str, Any]:
    """What the diagnosis says of the case's recording, and with `others` what the baselines make of it."""
    row, found = answered(case.driven(), case.rate_hz, case.left_out, case.nameable)
    if others:
        from bcid.proof.baselines import compared

        row["others"] = compared(found)
    return row


def _run(case: Case, code: str, folder: Path, others: bool) -> dict[str, Any]:
    try:
        row = run_case(case, others)
    except Exception as error:  # whatever it is, it is this case's miss and ends no other
        row = {"error": repr(error)}
    keep(row, _key(case, code), folder)
    return row


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

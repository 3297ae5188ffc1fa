"""Runs of blind cases: each is driven, diagnosed and stored as a row, several at a time, until time is up."""

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bcid.execution.jobs import ProcessLost, Workers, run_jobs
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.diagnose_case import diagnose_concealed_drive
from bcid.proof.rows import append_row, code_digest, read_rows

ROW_MODULES = ("bcid.simulation.drive", "bcid.simulation.room_drive", "bcid.proof.blind.diagnose_case")
"""Modules whose code, with all that they import, decides what a row holds."""


def case_truth(case: BlindCase) -> dict[str, Any]:
    """Fields of a blind case's result (row) that do not depend on the diagnosis: what was simulated and concealed.

    They are "case" (name), "tier" (kind of case), "duration_s", "answer" (ids of the concealed effects), "truth"
    (their parameters by effect and symbol), "left_out" (ids that the diagnosis is forbidden to name) and "channel"
    (where an effect acts that the diagnosis cannot name, such as "fx"; "" if it can).  "also" has ids of effects that
    are there besides and may be named, or not; "other_parameters" the true values by symbol of those that are published
    otherwise.
    """
    return {
        "case": case.name, "tier": case.tier, "answer": list(case.answer), "channel": case.channel,
        "truth": {**{c.effect: dict(c.parameters) for c in case.concealed}, **case.also},
        "left_out": list(case.left_out), "duration_s": case.duration_s, "also": list(case.also),
        "other_parameters": case.other_parameters,
    }  # fmt: skip


def run_all_cases(
    cases: Iterable[BlindCase],
    folder: Path,
    workers: Workers,
    with_baselines: bool = False,
    minutes: float | None = None,
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Yield the result (row: `case_truth` and diagnosis) of every blind case, stored ones first, then new ones.

    Rows are stored in `folder` under digests of the case and of the code; a case with an "error" is run again if
    there is time.  No case begins after so many `minutes`.  New cases run in the order of their digests, unrelated to
    their tiers, so that an unfinished run has some of each.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows, code, todo = read_rows(folder), case_code_digest(with_baselines), list[BlindCase]()
    for case in cases:
        row = rows.get(_row_key(case, code), {"error": "not run yet"})
        if "error" in row:
            todo.append(case)
        else:
            yield {**case_truth(case), **row}
    todo.sort(key=lambda case: case.digest())
    end = np.inf if minutes is None else time.monotonic() + 60.0 * minutes

    def prepare(case: BlindCase) -> Callable[[], dict[str, Any]] | None:
        if time.monotonic() >= end:
            return None
        run = partial(_run_case, case, with_baselines)
        return partial(_store_row_of, run, _row_key(case, code), folder) if on_this_machine else run

    # by the process that made it, which loses none; those of several machines might write into each other's lines
    on_this_machine, not_run = isinstance(workers, int), list(todo)
    for case, row in run_jobs(todo, prepare, workers, _lost_row):
        not_run.remove(case)
        if not on_this_machine:
            append_row(row, _row_key(case, code), folder)
        yield {**case_truth(case), **row}
    for case in not_run:
        # an error that there was no time to run again
        if _row_key(case, code) in rows:
            yield {**case_truth(case), **rows[_row_key(case, code)]}


def count_cases_with_rows(cases: Iterable[BlindCase], folder: Path) -> int:
    """Number of blind cases that have a stored result in `folder`, made by any version of the code."""
    there = {key.partition(".")[0] for key in read_rows(folder)}
    return sum(case.digest() in there for case in cases)


def case_code_digest(with_baselines: bool) -> str:
    """Digest (12 hex digits) of all code and library versions on which the result of a blind case depends.

    That is simulation and diagnosis, and with `with_baselines` the other methods that the diagnosis is compared with.
    """
    return code_digest((*ROW_MODULES, "bcid.proof.blind.baselines") if with_baselines else ROW_MODULES)


def _row_key(case: BlindCase, code: str) -> str:
    """Key of a blind case's stored result: the case's digest, a dot, and the digest `code` of the code that made it."""
    return f"{case.digest()}.{code}"


def run_blind_case(case: BlindCase, with_baselines: bool = False) -> dict[str, Any]:
    """Simulate and diagnose a blind case (a drive with concealed effects); return the fields of `diagnosis_row`.

    With `with_baselines` the field "others" has the answers of other methods to the same recording.
    """
    files = case.lab_files
    row, diagnosis = diagnose_concealed_drive(
        case.simulate(), case.rate_hz, case.left_out, case.nameable_effects, files.vehicle, files.simulation,
        tuple(case.also),
    )  # fmt: skip
    if with_baselines:
        from bcid.proof.blind.baselines import run_baselines

        row["others"] = run_baselines(diagnosis)
    return row


def _run_case(case: BlindCase, with_baselines: bool) -> dict[str, Any]:
    """The result (row) of a blind case and its name; an exception of any kind is a row with its text as "error".

    By its name a row is found on a processor that draws the last digits of a case otherwise, and with them its digest.
    """
    try:
        return {"case": case.name, **run_blind_case(case, with_baselines)}
    except Exception as error:  # whatever it is, it is this case's miss and ends no other
        return {"case": case.name, "error": repr(error)}


def _lost_row(case: BlindCase) -> dict[str, Any]:
    """The result (row) of a blind case of which process after process died."""
    return {"case": case.name, "error": f"{ProcessLost.__name__}: its process died each time that it was tried"}


def _store_row_of(run: Callable[[], dict[str, Any]], key: str, folder: Path) -> dict[str, Any]:
    """What `run` returns, a row, after appending it under `key` to the file in `folder`."""
    row = run()
    append_row(row, key, folder)
    return row

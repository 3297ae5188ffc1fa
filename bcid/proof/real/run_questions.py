"""Real recordings with a known omission: a published model less one of its effects must be told which one.

Controls are what must not be named: an effect that a drive does not excite, or any vehicle physics where the tracking
failed, beyond what other drives of the car show as well.  A last tier edits recordings (`bcid.proof.real.edits`), so
that what the edited ones show beyond the recording as it was is known exactly.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcid.errors import BcidError
from bcid.proof.blind.run_cases import pool_of
from bcid.proof.real import edited, withheld
from bcid.proof.real.question_files import Asked
from bcid.proof.real.questions import Cases, Edited, Withheld, read_cases
from bcid.proof.real.scoring import judged
from bcid.proof.rows import digest_of, keep, kept
from bcid.recording.read import read_recording
from bcid.vehicle import read_vehicle

JUDGED = ("bcid.proof.real.withheld", "bcid.proof.real.edited")
"""The modules whose code, with all that they import, makes a row what it is."""


class _Job(NamedTuple):
    """What makes a row, of what is asked and of the row that has to be there first, and the keys of the two."""

    answer: Callable[..., dict[str, Any]]
    key: str
    case: Withheld | Edited | None  # that the row answers; none of what edits are held against
    after: str = ""

    def told(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """The row with what was asked, and whether it is right."""
        assert self.case is not None  # noqa: S101  # nothing else is told
        return judged(self.case, {**self.case.head, **row})


def run_real(file: Path, recordings: Path, folder: Path, workers: int = 1) -> Iterator[tuple[dict[str, Any], float]]:
    """A row for each case of the TOML `file`, each as it is done, and the share that is done.

    `recordings` is where the recordings are.  What was said is kept in `folder`, under what was asked and the digest
    of the code that answers; whether it is right is judged anew each time.

    Raises:
        InputRefused: the file, or what it names.
    """
    cases = read_cases(file)
    asked = Asked(read_vehicle(cases.vehicle_file(file)), cases.calibrated, cases.simulation_file(file), recordings)
    asked.check(cases, file)
    folder.mkdir(parents=True, exist_ok=True)
    known, jobs = kept(folder), _jobs(cases, file, asked)
    there = {job.key: known[job.key] for job in jobs if job.key in known}
    todo = [job for job in jobs if job.key not in there]
    needed = {job.after for job in todo}
    todo = [job for job in todo if job.case or job.key in needed]
    rows = [job.told(there[job.key]) for job in jobs if job.case and job.key in there]
    for done, row in enumerate(chain(rows, _answered(todo, there, asked, folder, workers)), 1):
        yield row, done / cases.size


def code_of_rows() -> str:
    """The digest of the code that makes a row, and of the libraries' versions."""
    return digest_of(JUDGED)


def _jobs(cases: Cases, file: Path, asked: Asked) -> list[_Job]:
    """All that is asked, what edits are held against first: it takes longest."""
    code, drives = code_of_rows(), dict[str, str]()
    given = [p.read_text(encoding="utf-8") for p in (cases.vehicle_file(file), asked.simulation) if p]

    def key_of(recording: str, what: Any) -> str:
        if recording not in drives:
            read = read_recording(asked.recordings / recording, asked.vehicle_of(recording))
            drives[recording] = read.sha256  # commands may lie beside
        all_of_it = [what, cases.calibrated.get(recording), drives[recording], code, given]
        return f"real.{hashlib.sha256(json.dumps(all_of_it, sort_keys=True).encode()).hexdigest()[:24]}"

    def job(answer: Callable[..., dict[str, Any]], case: Withheld | Edited, after: str) -> _Job:
        return _Job(partial(answer, case), key_of(case.recording, case.asks), case, after)

    edits = {name: cases.edits_of(name) for name in dict.fromkeys(edit.recording for edit in cases.edited)}
    before = {name: _Job(partial(_before, name, es), key_of(name, [name, es]), None) for name, es in edits.items()}
    return [
        *before.values(),
        *(job(withheld.answered, case, "") for case in cases.withheld),
        *(job(_edited, case, before[case.recording].key) for case in cases.edited),
    ]


def _before(recording: str, effects: Sequence[str], asked: Asked) -> dict[str, Any]:
    return edited.as_it_was(recording, effects, asked).row()


def _edited(case: Edited, asked: Asked, before: Mapping[str, Any]) -> dict[str, Any]:
    return edited.answered(case, edited.Before.from_row(before), asked)


def _answered(
    jobs: Sequence[_Job], there: Mapping[str, dict[str, Any]], asked: Asked, folder: Path, workers: int
) -> Iterator[dict[str, Any]]:
    """The rows of all cases, each as it is done; `there` are such as come before some of them, by their keys."""
    before = dict(there)
    if workers <= 1:
        for job in jobs:
            before[job.key] = _row(job, before, asked, folder)
            if job.case:
                yield job.told(before[job.key])
        return
    with pool_of(workers) as pool:

        def submitted(ready: Iterable[_Job]) -> dict[Future[dict[str, Any]], _Job]:
            return {pool.submit(_row, job, before, asked, folder): job for job in ready}

        running = submitted(job for job in jobs if not job.after or job.after in before)
        while running:
            for ended in wait(running, return_when=FIRST_COMPLETED).done:
                job, row = running.pop(ended), ended.result()
                before[job.key] = row
                running |= submitted(other for other in jobs if other.after == job.key)
                if job.case:
                    yield job.told(row)


def _row(job: _Job, before: Mapping[str, dict[str, Any]], asked: Asked, folder: Path) -> dict[str, Any]:
    """What was answered, kept in `folder`; what ended in an error is told, and asked again next time.

    `before` holds the row of what comes before it.
    """
    first = [before[job.after]] if job.after else []
    error = next((row["error"] for row in first if "error" in row), None)
    if error is None:
        try:
            row = job.answer(asked, *first)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError, BcidError) as failed:
            error = repr(failed)
        else:
            keep(row, job.key, folder)
            return row
    return {"verdict": "error", "findings": [], "error": error}

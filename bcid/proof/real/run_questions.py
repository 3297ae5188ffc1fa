"""Runs of questions to real recordings, several at a time, their answers stored as rows and scored anew each time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bcid.errors import BcidError, UsageError
from bcid.execution.jobs import run_jobs
from bcid.proof.real.jobs import Job, list_jobs
from bcid.proof.real.scoring import may_have_answer, score_jobs
from bcid.proof.real.variations import AS_ASKED
from bcid.proof.rows import append_row, read_rows

Announce = Callable[[str, float], None]


def run_real_questions(
    files: Iterable[Path], recordings: Path, folder: Path, workers: int = 1, only: Sequence[str] = (),
    announce: Announce = lambda label, share: None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Answer the questions of TOML `files` about real recordings; return the scored rows of those asked.

    Answers are stored in `folder` under the question and the code, and reused by later calls, but scored anew each
    time.  `recordings` is the folder of the recordings.  With `only`, those jobs alone run whose label holds one of
    the texts, and what they need; as far as there are rows of others, they are scored, too.  A question that has no
    answer is not asked once more in another way.  `announce` is called with the label of each job that ends and the
    share done so far.

    Raises:
        InputRefused: a file of questions, or a file that it names, is invalid.
        UsageError: no job's label holds any text of `only`.
    """
    jobs = list({job.key: job for file in files for job in list_jobs(file, recordings)}.values())
    folder.mkdir(parents=True, exist_ok=True)
    rows = {key: row for key, row in read_rows(folder).items() if "error" not in row}
    wanted = _wanted_keys(jobs, only)
    needed = {job.key for job in jobs if job.key in wanted and job.key not in rows}
    # in reverse, as each job comes after those that it needs
    for job in reversed(jobs):
        if job.key in needed:
            needed |= {key for key in (*job.priors, *job.beside) if key not in rows}
    todo = [job for job in jobs if job.key in needed]

    def prepare(job: Job) -> Callable[[], dict[str, Any]] | None:
        asked_first = job.beside if job.variation != AS_ASKED else ()
        if any(key not in rows for key in (*job.priors, *asked_first)):
            return None
        if not all(may_have_answer(rows[key]) for key in asked_first):
            return None
        return partial(_run_and_store_job, job, [rows[key] for key in job.priors], folder, recordings)

    for done, (job, row) in enumerate(run_jobs(todo, prepare, workers), 1):
        rows[job.key] = row
        announce(job.label, done / len(todo))
    return score_jobs(jobs, rows)


def _wanted_keys(jobs: Sequence[Job], only: Sequence[str]) -> set[str]:
    """Keys of the jobs that answer a question, or of those whose label holds one of the texts `only`."""
    if not only:
        return {job.key for job in jobs if job.question}
    chosen = {job.key for job in jobs if any(text in job.label for text in only)}
    if not chosen:
        example = next((job.label for job in jobs if job.question), "")
        raise UsageError(
            f"--only {' '.join(only)}: no question has that\n  next: name a part of one, such as {example}"
        )
    return chosen


def _run_and_store_job(job: Job, priors: Sequence[Mapping[str, Any]], folder: Path, recordings: Path) -> dict[str, Any]:
    """Do a job, store its row in `folder`, and return the row.

    `priors` are the rows that it is made of.  A row with an "error" is returned but not stored, so that the job is done
    again next time; so is a job that is made of one.
    """
    error = next((prior["error"] for prior in priors if "error" in prior), None)
    if error is None:
        try:
            row = job.work(*priors)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError, BcidError) as failed:
            # a published row names no folder of ours
            error = repr(failed).replace(f"{recordings}{os.sep}", "")
        else:
            append_row(row, job.key, folder)
            return row
    return {"verdict": "error", "findings": [], "error": error}

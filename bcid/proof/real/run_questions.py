"""Runs of questions to real recordings, several at a time, their answers stored as rows.

Withheld questions take one effect from a published model; controls must not be named: effects that a drive does not
excite, or vehicle physics where the tracking failed; edits make an effect of known size in a recording.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcid.errors import BcidError
from bcid.proof.real import edited, withheld
from bcid.proof.real.question_files import QuestionInputs
from bcid.proof.real.questions import EditedQuestion, QuestionFile, WithheldQuestion, read_questions
from bcid.proof.real.scoring import score_answer
from bcid.proof.rows import append_row, code_digest, read_rows
from bcid.proof.workers import run_jobs
from bcid.recording.read import read_recording
from bcid.vehicle import read_vehicle

ROW_MODULES = ("bcid.proof.real.withheld", "bcid.proof.real.edited")
"""Modules whose code, with all that they import, decides what a row holds."""


class _Job(NamedTuple):
    """The making of one row: an answer to a question, or an unedited drive that edits are compared with."""

    answer: Callable[..., dict[str, Any] | edited.UneditedDrive]  # of the prior job's drive, if any, and of the inputs
    key: str
    question: WithheldQuestion | EditedQuestion | None  # that the row answers; None for an unedited drive
    prior_key: str = ""

    def score(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """The row of this job's question with what was asked, and whether the answer is right."""
        assert self.question is not None  # noqa: S101  # nothing else is told
        return score_answer(self.question, {**self.question.row_head, **row})


def run_real_questions(
    file: Path, recordings: Path, folder: Path, workers: int = 1
) -> Iterator[tuple[dict[str, Any], float]]:
    """Answer all questions of the TOML `file` about real recordings; yield each scored row and the share done so far.

    A question withholds something from the vehicle's published simulation, or edits a recording so that it shows an
    effect of known size; the diagnosis has to name it.  Answers are stored in `folder` under the question and the
    code, and reused by later calls, but scored anew each time.  `recordings` is the folder of the recordings.

    Raises:
        InputRefused: the file of questions, or a file that it names, is invalid.
    """
    questions = read_questions(file)
    inputs = QuestionInputs(read_vehicle(questions.vehicle), questions.calibrated, questions.simulation, recordings)
    inputs.check_vehicles(questions, file)
    folder.mkdir(parents=True, exist_ok=True)
    stored, jobs = read_rows(folder), _list_jobs(questions, inputs)
    rows = {job.key: stored[job.key] for job in jobs if job.key in stored}
    answered = [job.score(rows[job.key]) for job in jobs if job.question and job.key in rows]
    todo = [job for job in jobs if job.key not in rows]
    needed = {job.prior_key for job in todo}
    todo = [job for job in todo if job.question or job.key in needed]

    def prepare(job: _Job) -> Callable[[], dict[str, Any]] | None:
        may_begin = not job.prior_key or job.prior_key in rows
        return partial(_run_and_store_job, job, inputs, folder, rows.get(job.prior_key)) if may_begin else None

    def run_todo() -> Iterator[dict[str, Any]]:
        for job, row in run_jobs(todo, prepare, workers):
            rows[job.key] = row
            if job.question:
                yield job.score(row)

    for done, row in enumerate(chain(answered, run_todo()), 1):
        yield row, done / (len(questions.withheld) + len(questions.edited))


def question_code_digest() -> str:
    """Digest (12 hex digits) of all code and library versions on which the answers about real recordings depend."""
    return code_digest(ROW_MODULES)


def _list_jobs(questions: QuestionFile, inputs: QuestionInputs) -> list[_Job]:
    """List the jobs, one for each row to be stored: unedited drives, withheld questions, then edited recordings.

    A job has the function that does it and the key of its row, a digest of question, recording, vehicle file,
    simulation and code.  Jobs of edited recordings also have the key of the unedited drive's row that they need;
    diagnoses of unedited drives come first, as they take longest.
    """
    code, drives = question_code_digest(), dict[str, str]()
    given = [p.read_text(encoding="utf-8") for p in (questions.vehicle, questions.simulation) if p]

    def key_of(recording: str, what: Any) -> str:
        if recording not in drives:
            read = read_recording(inputs.recordings / recording, inputs.vehicle_for(recording))
            drives[recording] = read.sha256  # commands may lie beside
        all_of_it = [what, questions.calibrated.get(recording), drives[recording], code, given]
        return f"real.{hashlib.sha256(json.dumps(all_of_it, sort_keys=True).encode()).hexdigest()[:24]}"

    def job(
        answer: Callable[..., dict[str, Any]], question: WithheldQuestion | EditedQuestion, prior_key: str = ""
    ) -> _Job:
        key = key_of(question.recording, question.key_fields)
        return _Job(partial(answer, question), key, question, prior_key)

    unedited = dict[str, _Job]()
    for name in dict.fromkeys(question.recording for question in questions.edited):
        effects = tuple(sorted({edit.effect for edit in questions.edited if edit.recording == name}))
        answer = partial(edited.diagnose_unedited_drive, name, effects)
        unedited[name] = _Job(answer, key_of(name, [name, effects]), None)
    return [
        *unedited.values(),
        *(job(withheld.answer_withheld_question, question) for question in questions.withheld),
        *(job(edited.answer_edited_question, edit, unedited[edit.recording].key) for edit in questions.edited),
    ]


def _run_and_store_job(
    job: _Job, inputs: QuestionInputs, folder: Path, prior_row: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Do a job (one question, or the diagnosis of an unedited drive), store its row in `folder`, and return the row.

    `prior_row` is the row of the unedited drive, for a job that edits that drive.  A row with an "error" is returned
    but not stored, so that the job is done again next time.
    """
    error = (prior_row or {}).get("error")
    if error is None:
        try:
            before = [] if prior_row is None else [edited.UneditedDrive.from_row(prior_row)]
            answer = job.answer(*before, inputs)
            row = answer.as_row() if isinstance(answer, edited.UneditedDrive) else answer
        except (ArithmeticError, ValueError, np.linalg.LinAlgError, BcidError) as failed:
            error = repr(failed)
        else:
            append_row(row, job.key, folder)
            return row
    return {"verdict": "error", "findings": [], "error": error}

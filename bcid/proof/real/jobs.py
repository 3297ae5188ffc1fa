"""All that is to be done for a file of questions, as jobs: each makes one row, some of the rows of others.

A drive's simulation is calibrated on the diagnoses of its day's other drives; questions need it, edits need what the
unedited drive shows, and pairs of drives need what each shows alone.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from bcid.proof.real import day_model, edited, replication, transfer, withheld
from bcid.proof.real.question_files import QuestionInputs
from bcid.proof.real.questions import (
    DrivePair,
    EditedQuestion,
    QuestionFile,
    RecordedDrive,
    WithheldQuestion,
    read_questions,
)
from bcid.proof.real.variations import AS_ASKED, PARTS, STARTS, QuestionVariation
from bcid.proof.rows import code_digest
from bcid.recording.read import read_recording

ROW_MODULES = tuple(
    f"bcid.proof.real.{name}" for name in ("withheld", "edited", "transfer", "replication", "day_model")
)
"""Modules whose code, each with all that it imports, decides what a row holds that it makes."""

Question = WithheldQuestion | EditedQuestion | RecordedDrive | DrivePair


class Job(NamedTuple):
    """The making of one row: an answer to a question, or something that other jobs need."""

    key: str
    recording: str
    case: str
    work: Callable[..., dict[str, Any]]  # of the rows of `priors`
    priors: tuple[str, ...] = ()  # keys of rows that this one is made of
    question: Question | None = None  # that the row answers; None where it is only needed by others
    beside: tuple[str, ...] = ()  # keys of rows that the answer is scored with
    variation: QuestionVariation = AS_ASKED

    @property
    def label(self) -> str:
        """What `--only` is matched with: kind of question, recording, case and variation."""
        kind = type(self.question).__name__ if self.question else "needed"
        return "/".join([kind, self.recording, self.case, self.variation.name])


def question_code_digest() -> str:
    """Digest (12 hex digits) of all code and library versions on which the answers about real recordings depend."""
    return code_digest(ROW_MODULES)


def list_jobs(file: Path, recordings: Path) -> list[Job]:
    """List the jobs of a TOML file of questions about the recordings in a folder, each after those that it needs.

    Raises:
        InputRefused: the file, or one that it names, is invalid.
    """
    questions = read_questions(file)
    inputs = QuestionInputs.of_questions(questions, recordings)
    inputs.check_vehicles(questions, file)
    return list(_Planner(questions, inputs).plan())


class _Planner:
    """The jobs of one file of questions; those that several questions need are made once."""

    def __init__(self, questions: QuestionFile, inputs: QuestionInputs) -> None:
        self.questions, self.inputs = questions, inputs
        given = [p.read_text(encoding="utf-8") for p in (questions.vehicle, questions.simulation) if p]
        self.given, self.codes = given, {module: code_digest([module]) for module in ROW_MODULES}
        self.digests, self.made = dict[str, str](), dict[str, Job]()

    def plan(self) -> Iterator[Job]:
        """All jobs, each after those that it needs."""
        for drive in self.questions.drives:
            if not drive.predicted_only:
                yield from self._questions_to(drive)
        for pair in self.questions.pairs:
            fitted = self._diagnosis_job(pair.fit, freely=True)
            yield from self._new(fitted)
            work = partial(transfer.predict_other_drive, pair, self.inputs)
            yield self._job("transfer", (pair.fit, pair.test), "transfer", work, [fitted], question=pair)
        yield from self._replications()

    def _questions_to(self, drive: RecordedDrive) -> Iterator[Job]:
        """The questions to one drive, after what they need."""
        name = drive.recording
        fellows = self.questions.fellows(drive) if self.questions.simulation else ()
        own = [self._diagnosis_job(fellow, freely=False) for fellow in fellows]
        calibrate = partial(day_model.calibrate_simulation, name, fellows, self.inputs)
        day = self._job("day_model", (name, *fellows), "day", calibrate, own)
        answer = partial(withheld.answer_whole_question, name, self.inputs)
        # without a simulation nobody knows what is there, so that a name may be right: it is no control
        control = drive if self.questions.simulation or drive.tracking_fails else None
        whole = self._job("withheld", (name, *fellows), "nothing withheld", answer, [day], question=control)
        yield from self._new(*own, day, whole)
        if drive.tracking_fails:
            return
        for case, withholding in self.questions.withheld.items():
            question = WithheldQuestion(name, case, withholding)
            yield from self._variants(
                question, case, withholding.model_dump(), withheld.answer_withheld_question,
                lambda variation: day, (*STARTS, *PARTS), [whole],
            )  # fmt: skip
        for effect, value in self.questions.edits.items() if drive.edited else ():
            edit = EditedQuestion(name, effect, value)
            yield from self._variants(
                edit, f"{effect} {value:g}", list(edit), edited.answer_edited_question,
                partial(self._unedited_job, name), PARTS, [],
            )  # fmt: skip

    def _variants(
        self, question: WithheldQuestion | EditedQuestion, case: str, asked: Any, answer: Callable[..., dict[str, Any]],
        prior: Callable[[QuestionVariation], Job], variations: Iterable[QuestionVariation], beside: list[Job],
    ) -> Iterator[Job]:  # fmt: skip
        """A question as it is asked, and its variations, which are scored beside that; first what each needs.

        `answer` makes the row, of the row of the job that `prior` returns for a variation.
        """
        first: Job | None = None
        for variation in (AS_ASKED, *variations):
            needed = prior(variation)
            yield from self._new(needed)
            work = partial(answer, question, variation, self.inputs)
            job = self._job(
                "withheld" if isinstance(question, WithheldQuestion) else "edited",
                (question.recording,), case, work, [needed], asked, question,
                beside=beside if first is None else [first], variation=variation,
            )  # fmt: skip
            first = first or job
            yield job

    def _unedited_job(self, name: str, variation: QuestionVariation) -> Job:
        """What a drive, or the part of it that a variation keeps, shows before it is edited."""
        effects = tuple(sorted(self.questions.edits))
        work = partial(edited.diagnose_unedited_drive, name, effects, variation, self.inputs)
        return self._job("edited", (name,), "unedited", work, [], effects, variation=variation)

    def _diagnosis_job(self, name: str, freely: bool) -> Job:
        """A drive diagnosed alone, against the published simulation or freely."""
        work = partial(day_model.diagnose_drive, name, freely, self.inputs)
        return self._job("day_model", (name,), "freely" if freely else "published", work, [])

    def _replications(self) -> Iterator[Job]:
        """Pairs of drives of one day, in the order of the file, after the diagnosis of each."""
        for one, other in itertools.combinations(self.questions.drives, 2):
            if other.recording not in self.questions.fellows(one) or not one.shows_the_car:
                continue
            pair = DrivePair(fit=one.recording, test=other.recording)
            alone = [self._diagnosis_job(name, freely=True) for name in (pair.fit, pair.test)]
            yield from self._new(*alone)
            work = partial(replication.compare_drives, pair, self.inputs)
            yield self._job("replication", (pair.fit, pair.test), "replication", work, alone, question=pair)

    def _new(self, *jobs: Job) -> Iterator[Job]:
        """Those of the jobs that were not listed before."""
        for job in jobs:
            if job.key not in self.made:
                self.made[job.key] = job
                yield job

    def _job(
        self, made_by: str, recordings: tuple[str, ...], case: str, work: Callable[..., dict[str, Any]],
        priors: list[Job], asked: Any = None, question: Question | None = None, beside: Iterable[Job] = (),
        variation: QuestionVariation = AS_ASKED,
    ) -> Job:  # fmt: skip
        """A job about `recordings`, the first of which is asked; its key holds all that its row depends on.

        `made_by` is the module of this package, one of ROW_MODULES, whose code makes the row.
        """
        # a withheld question's name does not change its answer
        kind = case if question is None or isinstance(question, RecordedDrive | DrivePair) else type(question).__name__
        read = [(self._digest(name), self.questions.drive(name).vehicle) for name in recordings]
        code = self.codes[f"bcid.proof.real.{made_by}"]
        what = [kind, asked, read, variation, [prior.key for prior in priors], code, self.given]
        digest = hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:24]
        return Job(
            f"real.{digest}", " → ".join(recordings if isinstance(question, DrivePair) else recordings[:1]), case, work,
            tuple(prior.key for prior in priors), question, tuple(job.key for job in beside), variation,
        )  # fmt: skip

    def _digest(self, recording: str) -> str:
        """Digest of a recording's files, of which commands may lie beside the poses."""
        if recording not in self.digests:
            read = read_recording(self.inputs.recordings / recording, self.inputs.vehicle_for(recording))
            self.digests[recording] = read.sha256
        return self.digests[recording]

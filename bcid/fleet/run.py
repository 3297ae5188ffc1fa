"""A fleet worked on: its logs in as many processes as there are, each then predicted by the models of the one before.

A log that another process is at work on is passed over, and waited for only when nothing else is left to begin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, NamedTuple

from bcid.aliases import Progress
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.fleet import FleetDocument, FleetLog, LogProblem
from bcid.evaluation.seen_takes import TakeSteps, is_same_drive
from bcid.execution.jobs import Pool, run_jobs_in
from bcid.fleet.attempts import attempt, describe_lost_process
from bcid.fleet.labels import FleetLabels
from bcid.fleet.limits import LIMITS
from bcid.fleet.repeats import find_repeats
from bcid.fleet.tasks import FleetOrder, LogEvaluation, WorkedLog, evaluate_on, state_of, work_on_log
from bcid.fleet.together import DiagnosedLog, diagnose_together
from bcid.pipeline.takes import name_takes

REPORT_TOGETHER = "report it, with fleet.json; each log's own results are whole"


class FleetJob(NamedTuple):
    """A task of a fleet: all stages of one log, or the evaluation of its models; `waits` in the second try only."""

    kind: Literal["log", "evaluation"]
    number: int  # of the log
    waits: bool


def run_fleet(
    order: FleetOrder, logs: Sequence[Path], labels: FleetLabels, vehicle: str,
    pool: AbstractContextManager[Pool], progress: Progress = lambda share, text: None,
) -> FleetDocument:  # fmt: skip
    """Do what the order says to each of `logs` in the processes of `pool`; what came of each, in their order.

    The models of each log are evaluated on the next one of another drive that can be used, those of the last one on the
    first; what the diagnoses of all say together goes by the days and cars of their `labels`, each drive counted once.
    Nothing that goes wrong with a log is raised: its row says it; nor what goes wrong with all of them together.
    """
    fleet = _Fleet(order, logs, labels)
    for job, result in run_jobs_in(pool, fleet.jobs(), fleet.prepare, lambda job: describe_lost_process(job.kind)):
        fleet.take_over(job, result)
        progress(fleet.share_done(), fleet.describe_progress(job))
    together, problems = attempt(
        "what all logs say together", lambda: diagnose_together(fleet.diagnosed_logs(), labels.days), REPORT_TOGETHER
    )
    return FleetDocument(
        vehicle=vehicle, models=order.models, diagnosed=order.diagnose,
        logs=tuple(fleet.row_of(number) for number in range(len(logs))), together=together, problems=tuple(problems),
    )  # fmt: skip


class _Fleet:
    """What is known so far of the logs of a fleet, and what can be done next."""

    def __init__(self, order: FleetOrder, logs: Sequence[Path], labels: FleetLabels) -> None:
        """Begin with logs of which nothing is known but their labels."""
        names, self.labels = name_takes(logs), labels
        self.order, self.logs, self.names = order, logs, [names[log] for log in logs]
        self.rows, self.evaluations = dict[int, FleetLog](), dict[int, LogEvaluation]()
        self._locked, self._takes = set[tuple[str, int]](), dict[int, TakeSteps]()

    def jobs(self) -> list[FleetJob]:
        """All jobs in the order in which they begin: logs, evaluations, then those that were found locked, once more.

        An evaluation that still needs a log which was found locked cannot begin, so that log is waited for before it.
        """
        # a single log has no other that it could be tried on
        evaluated = len(self.logs) if len(self.logs) > 1 and self.order.models else 0
        return [
            job
            for waits in (False, True)
            for job in (
                *(FleetJob("log", number, waits) for number in range(len(self.logs))),
                *(FleetJob("evaluation", number, waits) for number in range(evaluated)),
            )
        ]

    def prepare(self, job: FleetJob) -> Callable[[], WorkedLog | LogEvaluation | None] | None:
        """What does a job; None while it cannot begin, or where there is nothing to be waited for."""
        if job.waits and (job.kind, job.number) not in self._locked:
            return None
        log = self.logs[job.number]
        if job.kind == "log":
            return partial(work_on_log, self.order, log, self.names[job.number], job.waits)
        unseen, row = self._next_usable(job.number), self.rows.get(job.number)
        models = [artifact.model for artifact in row.artifacts if artifact.stage == "fit"] if row else []
        if unseen is None or not models:
            return None
        return partial(evaluate_on, self.order, log, models, self.logs[unseen], self.names[unseen], job.waits)

    def _next_usable(self, number: int) -> int | None:
        """The number of the next log of another drive whose motion is estimated.

        None where there is none, or is not known yet.
        """
        count = len(self.logs)
        for other in ((number + step) % count for step in range(1, count)):
            if other not in self.rows:
                return None
            if self.rows[other].has("estimate") and not self._are_of_one_drive(number, other):
                return other
        return None

    def _are_of_one_drive(self, one: int, other: int) -> bool:
        """Whether the logs of these numbers were read and are of the same drive, at least in part."""
        return {one, other} <= self._takes.keys() and is_same_drive(self._takes[one], self._takes[other])

    def take_over(self, job: FleetJob, result: WorkedLog | LogEvaluation | LogProblem | None) -> None:
        """Take over what a job gave: None where it found its log locked, a problem where its process died."""
        if isinstance(result, LogProblem) and job.kind == "log":
            name, file = self.names[job.number], str(self.logs[job.number])
            self.rows[job.number] = FleetLog(name=name, file=file, state="failed", problems=(result,))
        elif isinstance(result, LogProblem):
            self.evaluations[job.number] = LogEvaluation(problems=(result,))
        elif isinstance(result, WorkedLog):
            self.rows[job.number] = result.row
            if result.take is not None:
                self._takes[job.number] = result.take
        elif isinstance(result, LogEvaluation):
            self.evaluations[job.number] = result
        else:
            self._locked.add((job.kind, job.number))

    @cached_property
    def repeats(self) -> dict[int, int]:
        """Numbers of the logs of another one's drive, with the number of that one, when all is done.

        Of the logs of one drive the one that counts is the first of those that were diagnosed.
        """
        first_diagnosed = sorted(self._takes, key=lambda number: (not self.rows[number].has("diagnose"), number))
        return find_repeats({number: self._takes[number] for number in first_diagnosed})

    def row_of(self, number: int) -> FleetLog:
        """All that came of a log, when all is done."""
        row, evaluation = self.rows[number], self.evaluations.get(number, LogEvaluation())
        first = self.repeats.get(number)
        row = row.model_copy(update={
            "day": self.labels.of_logs[number].day, "car": self.labels.of_logs[number].car,
            "artifacts": (*row.artifacts, *evaluation.artifacts), "scores": evaluation.scores,
            "problems": (*row.problems, *evaluation.problems), "notes": (*row.notes, *evaluation.notes),
            "same_drive_as": "" if first is None else self.names[first],
        })  # fmt: skip
        return row.model_copy(update={"state": state_of(row)})

    def diagnosed_logs(self) -> list[DiagnosedLog]:
        """The logs that were diagnosed, with what was found, one of each drive."""
        home = self.order.settings.workspace / "diagnose"
        return [
            DiagnosedLog(row.name, self.labels.of_logs[number], DiagnosisDocument.read(home / key / "diagnosis.json"))
            for number, row in sorted(self.rows.items())
            if number not in self.repeats
            for key in row.keys_of("diagnose")
        ]

    def share_done(self) -> float:
        """The share of the work that is done; evaluations count little, and those that cannot be made are none."""
        count = len(self.logs)
        evaluated = LIMITS.evaluation_share * len(self.evaluations)
        return min((len(self.rows) + evaluated) / (count * (1.0 + LIMITS.evaluation_share)), 1.0)

    def describe_progress(self, job: FleetJob) -> str:
        """How many logs are done, how many of them failed, and which was the last."""
        failed = sum(row.state == "failed" for row in self.rows.values())
        told = f"{len(self.rows)} of {len(self.logs)} logs" + (f", {failed} failed" if failed else "")
        found_locked = (job.kind, job.number) in self._locked and not job.waits
        return f"{told}; {self.names[job.number]}" + (" is locked, put off" if found_locked else "")

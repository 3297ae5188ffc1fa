"""What is done to one log of a fleet, in whatever process: its stages as single commands would run them.

A task takes paths and settings and gives a small row; all else lies in the workspace, under the keys that single
commands give it.  A log is worked on by itself: the estimator is tuned to it, models are fitted to it alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.fleet import FleetLog, KeptArtifact, LogProblem, LogScore, LogState, LogVerdict
from bcid.evaluation.seen_takes import TakeSteps
from bcid.fleet.attempts import TakeLocked, attempt
from bcid.pipeline.config import PipelineConfig
from bcid.pipeline.run import Pipeline
from bcid.pipeline.watching import NotingWatcher
from bcid.recording.saving import RecordingSummary
from bcid.store.artifact import Artifact

Result = TypeVar("Result")


@dataclass(frozen=True)
class FleetOrder:
    """What is to be done to each log of a fleet, in whatever process."""

    settings: PipelineConfig  # of all logs; recordings are not among them
    models: tuple[str, ...]
    diagnose: bool
    simulation: str | None = None  # that logs are compared with
    home: Path = field(default_factory=Path.cwd)  # of the process that gives the order: relative paths count from it

    def config_of(self, log: Path, unseen: Path | None = None) -> PipelineConfig:
        """The configuration of one log, as a command makes it for one that is named; `unseen` is to be predicted."""
        return self.settings.for_recording(self.home, log, unseen)


class WorkedLog(NamedTuple):
    """What came of one log, and by which of its steps its drive is known; None of a log that could not be read."""

    row: FleetLog
    take: TakeSteps | None = None


class LogEvaluation(NamedTuple):
    """What came of predicting another log with the models of one."""

    artifacts: tuple[KeptArtifact, ...] = ()
    scores: tuple[LogScore, ...] = ()
    problems: tuple[LogProblem, ...] = ()
    notes: tuple[str, ...] = ()


class _ImpatientWatcher(NotingWatcher):
    """A watcher of a pipeline that is not to wait for other processes."""

    def report_locked(self, text: str) -> None:
        """Leave the stage that would have to wait."""
        raise TakeLocked(text)


def work_on_log(order: FleetOrder, log: Path, name: str, waits: bool) -> WorkedLog | None:
    """Do all stages of one log but its evaluation; the row says what came of it, whatever goes wrong.

    Where another process is at work on the log, it is waited for if `waits`, and None is returned otherwise.
    """

    def work(watcher: NotingWatcher) -> WorkedLog:
        # the vehicle file is read anew, which another machine may not see
        begun, problems = attempt("settings", lambda: _LogWork(order, log, watcher))
        if begun is None:
            return WorkedLog(FleetLog(name=name, file=str(log), state="failed", problems=tuple(problems)))
        return WorkedLog(begun.run(name), begun.take)

    return _finish(work, waits)


def evaluate_on(
    order: FleetOrder, log: Path, models: Sequence[str], unseen: Path, unseen_name: str, waits: bool
) -> LogEvaluation | None:
    """Predict the log `unseen` with the models that were fitted to `log`; None as for `work_on_log`."""
    return _finish(lambda watcher: _evaluate(order, log, models, unseen, unseen_name, watcher), waits)


def _finish(work: Callable[[NotingWatcher], Result], waits: bool) -> Result | None:
    """The result of `work`; None where it would have to wait, and `waits` is not."""
    try:
        return work(NotingWatcher() if waits else _ImpatientWatcher())
    except TakeLocked:
        return None


def _evaluate(
    order: FleetOrder, log: Path, models: Sequence[str], unseen: Path, unseen_name: str, watcher: NotingWatcher
) -> LogEvaluation:
    """Scores of the models that were fitted to `log` on the log `unseen`, and why any has none."""
    work, problems = attempt("evaluate", lambda: Pipeline(order.config_of(log, unseen), watcher))
    if work is None:
        return LogEvaluation(problems=tuple(problems))
    artifacts, scores = list[KeptArtifact](), list[LogScore]()

    def evaluate(model: str) -> None:
        compared = work.fit_for_comparison(model)
        score, key = work.score(compared), work.models.evaluate(compared).key
        artifacts.append(KeptArtifact(stage="evaluate", key=key, model=model))
        scores.append(LogScore(model=model, on=unseen_name, nmse=score.nmse, nmse_ci95=score.nmse_ci95))

    for model in models:
        problems += attempt(f"evaluate {model}", partial(evaluate, model)).problems
    return LogEvaluation(tuple(artifacts), tuple(scores), tuple(problems), tuple(watcher.notes))


class _LogWork:
    """One log on its way through the stages, and what is known of it so far."""

    def __init__(self, order: FleetOrder, log: Path, watcher: NotingWatcher) -> None:
        """Begin with a log of which nothing is known."""
        self.order, self.given, self.watcher = order, log, watcher
        config = order.config_of(log)
        (self.log,) = config.training
        self.work = Pipeline(config, watcher)
        self.artifacts, self.problems, self.figures = list[KeptArtifact](), list[LogProblem](), dict[str, Any]()
        self.take: TakeSteps | None = None

    def run(self, name: str) -> FleetLog:
        """Do what the order says, as far as one stage does not need what another one failed to make; the log's row."""
        needed = {"ingest": self._ingest, "check": self._refuse_unusable, "estimate": self._estimate}
        if all(self._does(stage, step) for stage, step in needed.items()):
            for model in self.order.models:
                self._does(f"fit {model}", partial(self._fit, model))
            if self.order.diagnose:
                self._does("diagnose", self._diagnose)
        # what could be read of a damaged file was used, as was allowed
        self._does("ingest", self.work.raise_if_parts_lost)
        row = FleetLog(
            name=name, file=str(self.given), state="done", artifacts=tuple(self.artifacts),
            problems=tuple(self.problems), notes=tuple(self.watcher.notes), **self.figures,
        )  # fmt: skip
        return row.model_copy(update={"state": state_of(row)})

    def _does(self, stage: str, step: Callable[[], None]) -> bool:
        """Do a step and say whether it went well; if not, why is remembered."""
        problems = attempt(stage, step).problems
        self.problems += problems
        return not problems

    def _keep(self, stage: str, artifact: Artifact, model: str = "") -> Artifact:
        """Remember an artifact of the log, once: a step may be done twice."""
        kept = KeptArtifact(stage=stage, key=artifact.key, model=model)
        if kept not in self.artifacts:
            self.artifacts.append(kept)
        return artifact

    def _ingest(self) -> None:
        """Read the log and check it."""
        summary = RecordingSummary.read(self._keep("ingest", self.work.ingest(self.log)).folder / "recording.json")
        self.take = self.work.takes.steps(self.log).keep_some()
        self.figures["duration_s"] = summary.duration_s
        self.figures["go"] = all(odd.action != "no-go" for odd in summary.irregularities)

    def _refuse_unusable(self) -> None:
        """Raise `InputRefused` where the check says no-go, unless the settings say to ignore that."""
        self.work.refuse_unusable([self.log])

    def _estimate(self) -> None:
        """Tune the estimator to the log, and smooth its motion."""
        self._keep("tune", self.work.takes.tune())
        self._keep("estimate", self.work.estimate(self.log))

    def _fit(self, model: str) -> None:
        """Fit one model."""
        self._keep("fit", self.work.fit(model), model)

    def _diagnose(self) -> None:
        """Diagnose the log, and write the page."""
        from bcid.report.verdict_words import verdict_sentence

        made = self._keep("diagnose", self.work.diagnose(self.order.simulation))
        self._keep("diagnosis_page", self.work.diagnosis_page(made))
        document = DiagnosisDocument.read(made.folder / "diagnosis.json")
        self.figures["diagnosis"] = LogVerdict(
            verdict=document.verdict, effects=tuple(finding.effect for finding in document.findings),
            sentence=verdict_sentence(document),
        )  # fmt: skip


def state_of(row: FleetLog) -> LogState:
    """How far a log came: where something failed, partly if a model or a diagnosis of it is there all the same."""
    if not row.problems:
        return "done"
    return "partly" if row.has("fit") or row.has("diagnose") else "failed"

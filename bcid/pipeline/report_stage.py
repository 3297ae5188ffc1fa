"""The stage `report`: the comparison of models on the validation recording, and all that goes into it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bcid.aliases import Progress
from bcid.errors import UsageError
from bcid.models.table import model_row
from bcid.pipeline.diagnosis_stages import DiagnosisStages
from bcid.pipeline.model_stages import ComparedModel, ModelStages, label_uniquely
from bcid.pipeline.origin import origin_key, trace_origin
from bcid.pipeline.stage_runner import StageRunner
from bcid.pipeline.take_stages import TakeStages
from bcid.store.artifact import Artifact

if TYPE_CHECKING:
    from bcid.pipeline.model_card import Origin


class ReportExtent(NamedTuple):
    """What a report makes beside the models that it compares, where it is not there yet."""

    losses: bool  # the models fitted by each loss that the report compares
    diagnosis: bool  # of the recordings that the configuration diagnoses


WHOLE = ReportExtent(losses=True, diagnosis=True)
MODELS_ALONE = ReportExtent(losses=False, diagnosis=False)


class ReportParts(NamedTuple):
    """All artifacts that a report is made from, and what they are called."""

    models: list[tuple[ComparedModel, Artifact]]  # each with its evaluation
    losses: list[tuple[ComparedModel, str, Artifact]]  # model, loss, evaluation
    validation: Artifact  # the estimated motion
    takes: list[tuple[Artifact, Artifact, Artifact | None]]  # recording, motion, check against the truth
    names: list[str]  # of the takes
    diagnosis: Artifact | None
    origin: Origin

    def inputs(self) -> dict[str, Any]:
        """What counts in the report's key."""
        return {
            "diagnosis": self.diagnosis.content if self.diagnosis else None,
            "models": [[c.label, c.content, e.content, c.saw_validation] for c, e in self.models],
            "losses": [[c.label, loss, e.content] for c, loss, e in self.losses],
            "takes": [[a.content if a else None for a in take] for take in self.takes],
            "names": self.names,
            "vehicle": self.origin.vehicle,
            **origin_key(self.origin),
        }


class ReportStage:
    """The report of one configuration."""

    def __init__(self, runner: StageRunner, takes: TakeStages, models: ModelStages, diagnoses: DiagnosisStages) -> None:
        """Each argument runs the stages that the report rests on; `runner` runs the report itself."""
        self.runner = runner
        self.takes = takes
        self.models = models
        self.diagnoses = diagnoses

    def report(
        self, saved_models: Sequence[Path] = (), models: Sequence[str] | None = None, extent: ReportExtent = WHOLE
    ) -> Artifact:
        """Artifact of the comparison of `models`, by default all of the configuration's, and of `saved_models`.

        What the `extent` leaves out is in the report all the same where it is there already.

        Raises:
            UsageError: there is no model to compare.
            InputRefused: a recording or a saved model cannot be used, or the validation take is one of training.
        """
        from bcid.models.saving import has_own_effects

        config = self.runner.config
        if extent.diagnosis and config.diagnose:
            self.runner.refuse_unnamed_effects()
        models = config.models if models is None else models
        self.models.refuse_untrainable(models)
        self.takes.refuse_unusable([*config.recordings(), *(config.diagnose if extent.diagnosis else ())])
        parts = self._gather(saved_models, models, extent)
        settings = config.report.model_dump()

        def make(folder: Path, progress: Progress) -> None:
            _write_report(folder, parts, settings)

        modules = [c.module for c, _ in parts.models]
        own = parts.diagnosis is not None or any(has_own_effects(c.folder) for c, _ in parts.models)
        return self.runner.run_stage("report", "", parts.inputs(), settings, make, *modules, own_effects=own)

    def _gather(self, saved_models: Sequence[Path], models: Sequence[str], extent: ReportExtent) -> ReportParts:
        """Make or find all that the report is made from."""
        recordings = self.runner.config.recordings()
        loaded = [
            self.models.mark_if_seen(self.models.load_for_comparison(folder)) for folder in dict.fromkeys(saved_models)
        ]
        self.takes.refuse_seen_validation()
        validation = self.takes.estimate(self.takes.validation_recording())
        compared = label_uniquely([*(self.models.fit_for_comparison(m) for m in models), *loaded])
        evaluated = [(c, self.models.evaluate(c)) for c in compared]
        if not evaluated:
            raise UsageError("the pipeline file names no models\n  next: list some in the pipeline file")
        losses = self._evaluate_losses(models, extent.losses)
        takes = [(self.takes.ingest(p), self.takes.estimate(p), self.takes.check(p)) for p in recordings]
        names = [self.takes.names[p] for p in recordings]
        diagnosis = self._diagnosis(extent)
        origin = trace_origin(self.takes, recordings)
        return ReportParts(evaluated, losses, validation, takes, names, diagnosis, origin)

    def _evaluate_losses(self, models: Sequence[str], fits: bool) -> list[tuple[ComparedModel, str, Artifact]]:
        """Evaluate those of `models` that can be fitted by each loss that the report compares: model, loss, evaluation.

        Where not `fits`, only those that have been fitted by it already.
        """
        evaluated = []
        for loss in self.runner.config.report.losses:
            fitted_so = self.models.with_loss(loss)
            names = [m for m in models if loss in model_row(m).losses and (fits or fitted_so.find_fit(m))]
            # each is evaluated before the next is fitted
            compared = (fitted_so.fit_for_comparison(m) for m in names)
            evaluated += [(c, str(loss), fitted_so.evaluate(c)) for c in compared]
        return evaluated

    def _diagnosis(self, extent: ReportExtent) -> Artifact | None:
        """The diagnosis that the report shows: made where the `extent` says so, else the one that is there, if any."""
        if extent.diagnosis and self.runner.config.diagnose:
            return self.diagnoses.diagnose()
        return self.diagnoses.find_diagnosis()


def _write_report(folder: Path, parts: ReportParts, settings: dict[str, Any]) -> None:
    """Write the report's files to `folder`."""
    from bcid.pipeline.stages import report

    models = [report.EvaluatedModel(c.label, c.settings, c.folder, e.folder, c.saw_validation) for c, e in parts.models]
    losses = [report.LossEvaluation(c.label, loss, e.folder) for c, loss, e in parts.losses]
    takes = [(r.folder, e.folder, check.folder if check else None) for r, e, check in parts.takes]
    report.run_report_stage(
        folder, models, parts.validation.folder, takes, settings, parts.origin.vehicle,
        parts.diagnosis.folder if parts.diagnosis else None, losses, parts.names, parts.origin,
    )  # fmt: skip

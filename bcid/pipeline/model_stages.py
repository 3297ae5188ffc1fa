"""The stages of models: `fit` and `evaluate`; saved models loaded to be compared; and the score of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bcid.aliases import Progress
from bcid.errors import InputRefused
from bcid.models.table import fittable_row, model_row, require_training_libraries
from bcid.pipeline.limits import LIMITS
from bcid.pipeline.stage_runner import SEEN_TAKES_MODULE, NotMadeYet, StageRunner
from bcid.pipeline.take_stages import TakeStages
from bcid.store.artifact import Artifact, file_sha256

if TYPE_CHECKING:
    from bcid.documents.report import EvaluationDocument
    from bcid.models.settings import CarLoss


class ComparedModel(NamedTuple):
    """A model that the report compares, fitted by this pipeline or saved in any folder."""

    label: str  # its name in the comparison
    folder: Path
    content: Any  # digests of its files
    module: str  # whose code predicts
    settings: Mapping[str, Any]  # of its fit
    saw_validation: bool | None = False  # whether it was made from the validation take; None where nobody knows


class ModelStages:
    """The fitted models of a configuration, and how well they and others predict its validation recording."""

    def __init__(self, runner: StageRunner, takes: TakeStages) -> None:
        """`runner` has the configuration by which models are fitted, and `takes` the recordings."""
        self.runner = runner
        self.takes = takes

    def with_loss(self, loss: CarLoss) -> ModelStages:
        """These stages with models fitted by `loss`; what is known of recordings is shared."""
        return ModelStages(self.runner.with_config(self.runner.config.with_loss(loss)), self.takes)

    # --- the stages -------------------------------------------------------------------------------------------------

    def fit(self, model: str, **overrides: Any) -> Artifact:
        """Artifact of one model, fitted with the configuration's settings except for `overrides`."""
        row, config = fittable_row(model), self.runner.config
        self.takes.refuse_unusable(config.training)
        base = self.fit(row.base, **row.base_settings) if row.base else None
        estimates = [self.takes.estimate(p) for p in config.training]
        settings = config.fit_settings(model) | overrides
        recordings = [self.takes.ingest(p) for p in config.training] if settings.get("loss") == "poses" else []
        inputs = {
            "model": model,
            "estimates": [a.content for a in estimates],
            "recordings": [a.content for a in recordings],
            "vehicle": self.runner.vehicle_parts("body", "steering", "motor"),
            "base": base.content if base else None,
        }

        def make(folder: Path, progress: Progress) -> None:
            from bcid.evaluation.seen_takes import save_seen_takes
            from bcid.pipeline.stages import fit

            fit.run_fit_stage(
                folder, model, [a.folder for a in estimates], self.runner.vehicle, settings, config.seed,
                base.folder if base else None, [a.folder for a in recordings], progress,
            )  # fmt: skip
            save_seen_takes([self.takes.steps(p) for p in config.training], folder)

        on = {"rollout": " on rollouts", "poses": " on poses"}.get(str(settings.get("loss")), "")
        modules = (row.module, SEEN_TAKES_MODULE)
        return self.runner.run_stage("fit", f"{model}{on}", inputs, settings, make, *modules, seed=config.seed)

    def find_fit(self, model: str) -> Artifact | None:
        """Artifact of a model that was fitted with the configuration's settings already; None where it was not."""
        try:
            return ModelStages(self.runner.only_reusing(), self.takes).fit(model)
        except NotMadeYet:
            return None

    def refuse_untrainable(self, models: Sequence[str]) -> None:
        """Raise `LibraryMissing` where one of `models` cannot be trained here, before the others take their time.

        A workspace that holds fits may hold these models', which need no training any more.
        """
        if not (self.runner.config.workspace / "fit").is_dir():
            require_training_libraries(models)

    def evaluate(self, model: ComparedModel) -> Artifact:
        """Artifact of one model's predictions of the validation recording, and their errors."""
        from bcid.models.saving import has_own_effects

        config = self.runner.config
        validation = self.takes.estimate(self.takes.validation_recording())
        training = [self.takes.estimate(p) for p in config.training]
        settings = {"restart_s": config.report.restart_s}
        inputs = {"fit": model.content, "validation": validation.content, "training": [a.content for a in training]}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import evaluate

            takes = [a.folder for a in training]
            evaluate.run_evaluate_stage(folder, model.folder, validation.folder, takes, settings["restart_s"])

        own = has_own_effects(model.folder)
        return self.runner.run_stage(
            "evaluate", model.label, inputs, settings, make, model.module, own_effects=own
        )  # fmt: skip

    def score(self, model: ComparedModel) -> EvaluationDocument:
        """The closed-loop error of one model on the validation recording, the same as in the report.

        Raises:
            InputRefused: no validation take is named, it is no-go, or it is of the drive of a training take.
        """
        from bcid.documents.report import EvaluationDocument

        self.takes.refuse_unusable([self.takes.validation_recording()])
        self.takes.refuse_seen_validation()
        return EvaluationDocument.read(self.evaluate(model).folder / "evaluation.json")

    # --- models to be compared --------------------------------------------------------------------------------------

    def fit_for_comparison(self, model: str) -> ComparedModel:
        """Fit one of the configuration's models for the comparison."""
        fit, settings = self.fit(model), self.runner.config.fit_settings(model)
        return ComparedModel(model, fit.folder, fit.content, model_row(model).module, settings)

    def load_for_comparison(self, folder: Path) -> ComparedModel:
        """Load a model that was saved in `folder`, whatever made it, for a comparison.

        Raises:
            InputRefused: there is no model, or its period differs from `estimate.period_s` of the configuration.
        """
        from bcid.evaluation.validity import FILE_NAME as VALIDITY_FILE
        from bcid.models.saving import FILES, load_model

        with self.runner.own_effects_of(folder):
            model, period_s = load_model(folder), self.runner.config.estimate.period_s
        if abs(model.period_s - period_s) > LIMITS.max_period_difference_s:
            cause = f"steps by {model.period_s:g} s, but the pipeline's grid has {period_s:g} s"
            raise InputRefused(folder, "model.json", cause, f"set period_s = {model.period_s:g} in [estimate]")
        content = {name: file_sha256(folder / name) for name in (*FILES, VALIDITY_FILE) if (folder / name).exists()}
        return ComparedModel(model.name, folder, content, model_row(model.name).module, {})

    def mark_if_seen(self, model: ComparedModel) -> ComparedModel:
        """A saved model with word of whether it was made from the validation take; where nobody knows, a note."""
        from bcid.evaluation.seen_takes import has_seen, load_seen_takes

        saw = has_seen(load_seen_takes(model.folder), self.takes.steps(self.takes.validation_recording()))
        if saw is None:
            doubt = f"{model.folder}: not known from which takes it was made; it may have seen this one"
            self.runner.watcher.note(doubt)
        return model._replace(saw_validation=saw)


def label_uniquely(candidates: Sequence[ComparedModel]) -> list[ComparedModel]:
    """Compared models with unique labels: a repeated label gets " (PARENT/NAME)" of the model's folder appended."""
    names = [c.label for c in candidates]
    return [
        c._replace(label=f"{c.label} ({'/'.join(c.folder.parts[-2:])})")
        if names.count(c.label) > 1 and names.index(c.label) < i
        else c
        for i, c in enumerate(candidates)
    ]

"""A pipeline: everything that can be made of one configuration, made when it is first asked for, and copies of it.

The stages themselves are in `take_stages`, `model_stages`, `diagnosis_stages` and `report_stage`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bcid.pipeline.config import PipelineConfig
from bcid.pipeline.diagnosis_stages import DiagnosisStages
from bcid.pipeline.model_stages import ComparedModel, ModelStages
from bcid.pipeline.named_models import MODEL_FILES, MODELS_FOLDER
from bcid.pipeline.publishing import are_published, artifact_digests, publish_copies, refuse_to_replace
from bcid.pipeline.report_stage import WHOLE, ReportExtent, ReportStage
from bcid.pipeline.stage_runner import StageRunner
from bcid.pipeline.take_stages import TakeStages
from bcid.pipeline.watching import Watcher
from bcid.store.artifact import Artifact

if TYPE_CHECKING:
    from bcid.documents.report import EvaluationDocument
    from bcid.vehicle import Vehicle


class Pipeline:
    """The artifacts of one configuration, each made when it is first asked for, and their copies for people."""

    def __init__(self, config: PipelineConfig, watcher: Watcher | None = None) -> None:
        """Read the vehicle file and open the store of `config`; `watcher` follows the stages as they run."""
        self.runner = StageRunner(config, watcher)
        self.takes = TakeStages(self.runner)
        self.models = ModelStages(self.runner, self.takes)
        self.diagnoses = DiagnosisStages(self.runner, self.takes, self.models)
        self.reports = ReportStage(self.runner, self.takes, self.models, self.diagnoses)

    @property
    def config(self) -> PipelineConfig:
        """What is made, and by which settings."""
        return self.runner.config

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle of all recordings."""
        return self.runner.vehicle

    # --- recordings -------------------------------------------------------------------------------------------------

    @property
    def names(self) -> dict[Path, str]:
        """What each recording is called where several are shown."""
        return self.takes.names

    def validation_name(self) -> str | None:
        """What the validation recording is called where several are shown; None where none is named."""
        return self.names.get(self.config.validation) if self.config.validation else None

    def ingest(self, recording: Path) -> Artifact:
        """Artifact of one ingested recording: poses, commands and irregularities."""
        return self.takes.ingest(recording)

    def estimate(self, recording: Path) -> Artifact:
        """Artifact of the smoothed motion of one recording."""
        return self.takes.estimate(recording)

    def check(self, recording: Path) -> Artifact | None:
        """Artifact of the estimator's errors against a simulated recording's truth; None where no truth is known."""
        return self.takes.check(recording)

    def refuse_unusable(self, recordings: Sequence[Path]) -> None:
        """Raise `InputRefused` where the check of a recording says no-go, unless health is to be ignored."""
        self.takes.refuse_unusable(recordings)

    def raise_if_parts_lost(self) -> None:
        """Raise `PartLost` where a part of a recording that has been ingested so far could not be read."""
        self.takes.raise_if_parts_lost()

    # --- models -----------------------------------------------------------------------------------------------------

    def fit(self, model: str) -> Artifact:
        """Artifact of one model, fitted with the configuration's settings."""
        return self.models.fit(model)

    def find_fit(self, model: str) -> Artifact | None:
        """Artifact of a model that was fitted with the configuration's settings already; None where it was not."""
        return self.models.find_fit(model)

    def refuse_untrainable(self, models: Sequence[str]) -> None:
        """Raise `LibraryMissing` where one of `models` cannot be trained here, unless the workspace holds fits."""
        self.models.refuse_untrainable(models)

    def fit_for_comparison(self, model: str) -> ComparedModel:
        """Fit one of the configuration's models for a comparison."""
        return self.models.fit_for_comparison(model)

    def load_for_comparison(self, folder: Path) -> ComparedModel:
        """Load a model that was saved in `folder`, for a comparison; raise `InputRefused` where it does not fit."""
        return self.models.load_for_comparison(folder)

    def score(self, model: ComparedModel) -> EvaluationDocument:
        """The closed-loop error of one model on the validation recording, the same as in the report."""
        return self.models.score(model)

    # --- results ----------------------------------------------------------------------------------------------------

    def diagnose(self, simulation: str | None = None) -> Artifact:
        """Artifact of the diagnosis: what physics the recordings show that the base model, or `simulation`, lacks."""
        return self.diagnoses.diagnose(simulation)

    def find_diagnosis(self) -> Artifact | None:
        """Artifact of the diagnosis of the configuration's recordings; None where none was made of them as they are."""
        return self.diagnoses.find_diagnosis()

    def diagnosis_page(self, diagnosis: Artifact) -> Artifact:
        """Artifact of the page of a diagnosis of the configuration's recordings, and of the card of its model."""
        return self.diagnoses.diagnosis_page(diagnosis)

    def report(
        self, saved_models: Sequence[Path] = (), models: Sequence[str] | None = None, extent: ReportExtent = WHOLE
    ) -> Artifact:
        """Artifact of the comparison of `models`, by default all of the configuration's, and of `saved_models`."""
        return self.reports.report(saved_models, models, extent)

    # --- copies for people ------------------------------------------------------------------------------------------

    def publish(self, artifact: Artifact, *names: str, to: str) -> Path:
        """Copy an artifact's files and folders to WORKSPACE/`to`, as `publish_copies` does; return the first copy."""
        home = self.config.workspace / to
        if are_published(artifact.folder, names, home):
            return home / names[0]
        with self.runner.store.exclusive_lock("publish"):
            known = artifact_digests(self.config.workspace)
            return publish_copies(artifact.folder, names, home, known, self.config.force)

    def publish_fit(self, fit: Artifact, name: str) -> Path:
        """Copy a fitted model to WORKSPACE/models/`name`, where it is found by that name; returns the copy's folder."""
        return self.publish(fit, *MODEL_FILES, to=f"{MODELS_FOLDER}/{name}").parent

    def refuse_to_publish_over(self, *names: str, to: str) -> None:
        """Raise `InputRefused` where `publish` would refuse, so that nobody waits for what cannot be published."""
        known = artifact_digests(self.config.workspace)
        refuse_to_replace(names, self.config.workspace / to, known, self.config.force)

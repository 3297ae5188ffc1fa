"""The stages of a pipeline, each run when it is first needed and reused where it is in the cache."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bcid.aliases import Progress
from bcid.errors import InputRefused, PartLost, Problem, Problems, UsageError
from bcid.files.source_code import stage_code
from bcid.models.table import fittable_row, model_row, require_training_libraries
from bcid.pipeline.config import PipelineConfig
from bcid.pipeline.cuts import split_cut, without_cut
from bcid.pipeline.limits import LIMITS
from bcid.pipeline.named_models import MODEL_FILES, MODELS_FOLDER
from bcid.pipeline.progress import spread_rounds
from bcid.pipeline.publishing import are_published, artifact_digests, publish_copies, refuse_to_replace
from bcid.pipeline.takes import name_takes, refuse_repeats
from bcid.pipeline.watching import Watcher
from bcid.recording.formats.detect import detect_format, find_commands_file, recording_files
from bcid.store.artifact import Artifact, Recipe, Store, file_sha256, is_whole
from bcid.vehicle import read_vehicle

if TYPE_CHECKING:
    from bcid.documents.report import EvaluationDocument
    from bcid.effects.own_file import OwnFile
    from bcid.evaluation.seen_takes import TakeSteps
    from bcid.models.settings import CarLoss
    from bcid.pipeline.model_card import Origin

AXLE_KEYS = ("body.cog_to_front_m", "body.cog_to_rear_m")
COSTLY_STAGES = ("fit", "diagnose")
"""Stages that take minutes; a report of what is there waits for none of them."""
SEEN_TAKES_MODULE = "bcid.evaluation.seen_takes"
ESTIMATOR_KEYS = (*AXLE_KEYS, "body.drive", "body.front_drive_share", "steering")


class NotMadeYet(Exception):
    """A fit or a diagnosis is not in the workspace, and was only to be reused."""


class ComparedModel(NamedTuple):
    """A model that the report compares, fitted by this pipeline or saved in any folder."""

    label: str  # its name in the comparison
    folder: Path
    content: Any  # digests of its files
    module: str  # whose code predicts
    settings: Mapping[str, Any]  # of its fit
    saw_validation: bool | None = False  # whether it was made from the validation take; None where nobody knows


class ReportExtent(NamedTuple):
    """What a report makes beside the models that it compares, where it is not there yet."""

    losses: bool  # the models fitted by each loss that the report compares
    diagnosis: bool  # of the recordings that the configuration diagnoses


WHOLE = ReportExtent(losses=True, diagnosis=True)


class Pipeline:
    """The artifacts of one configuration, each made when it is first asked for."""

    def __init__(self, config: PipelineConfig, watcher: Watcher | None = None) -> None:
        """Read the vehicle file and open the store of `config`."""
        self.config = config
        self.vehicle = read_vehicle(config.vehicle)
        self.watcher = watcher or Watcher()
        waiting = f"waiting for another run, which is at work in {config.workspace}"
        self.store = Store(config.workspace, lambda: self.watcher.note(waiting), self.watcher.note)
        self._known: dict[str, Artifact] = {}
        # of each recording, read and checked once
        self._ingested: dict[Path, Artifact] = {}
        self._estimated: dict[Path, Artifact] = {}
        self._usable: set[Path] = set()
        self._tuned: Artifact | None = None
        self._steps: dict[Path, TakeSteps] = {}
        # whether fits and diagnoses that are not there are made, not only reused
        self._makes_costly = True
        # what each recording is called where several are shown
        self.names = name_takes([*config.recordings(), *config.diagnose])

    def _run_stage(
        self, stage: str, subject: str, inputs: Mapping[str, Any], settings: Mapping[str, Any],
        make: Callable[[Path, Progress], None], *modules: str, seed: int | None = None, own_effects: bool = False,
    ) -> Artifact:  # fmt: skip
        """Return the stage's artifact, from the cache where it is there, else made by `make(folder, progress)`.

        `subject` stands after the stage's name in messages; `modules` run beside the stage's own and count in its key.
        The user's file of effects is code: it is run, and in use, only where the stage needs `own_effects`.
        """
        recipe = Recipe(stage, inputs, settings, stage_code(f"bcid.pipeline.stages.{stage}", *modules), seed)
        title = f"{stage} {subject}".rstrip()
        if recipe.key in self._known:
            return self._known[recipe.key]
        only_reused = stage in COSTLY_STAGES and not self._makes_costly
        if only_reused and not is_whole(self.config.workspace / stage / recipe.key, recipe):
            raise NotMadeYet

        def watched(folder: Path) -> None:
            with self.watcher.stage(title) as progress, self._own_effects_in_use(own_effects):
                make(folder, progress)

        artifact = self.store.get_or_make(recipe, watched)
        if artifact.reused:
            self.watcher.report_reused(title)
        self._known[recipe.key] = artifact
        return artifact

    @cached_property
    def _own_effects(self) -> OwnFile | None:
        """The user's own effects: of the file that the configuration names, read and checked, or of one in use already.

        None where there is neither.

        Raises:
            InputRefused: the file is wrong, or nobody named it, nor the pipeline file that names it: it is code.
        """
        from bcid.effects.own_file import IN_USE, read_own_effects

        if self.config.effects is None:
            return IN_USE[0] if IN_USE else None
        self._refuse_unnamed_effects()

        return read_own_effects(self.config.effects)

    def _refuse_unnamed_effects(self) -> None:
        """Raise `InputRefused` where the user's file of effects is named only by a pipeline file that nobody named."""
        if self.config.effects is not None and not self.config.effects_named:
            cause = f"names {self.config.effects}, a program that would be run; this pipeline file was only found here"
            step = f"read that file; if you trust it, give --effects {self.config.effects}, or -p {self.config.source}"
            raise InputRefused(self.config.source, "effects", cause, step)

    def own_effects_of(self, model: Path) -> AbstractContextManager[None]:
        """Context in which the model saved in the folder `model` can be loaded and used.

        The user's own effects are in the vocabulary where the model has some.

        Raises:
            InputRefused: the user's file of effects is wrong, or nobody named it.
        """
        from bcid.models.saving import has_own_effects

        return self._own_effects_in_use(has_own_effects(model))

    def _own_effects_in_use(self, needed: bool) -> AbstractContextManager[None]:
        """Context in which the vocabulary holds the user's own effects beside its own, if they are `needed`."""
        if not needed or self._own_effects is None:
            return nullcontext()
        from bcid.effects.own_file import own_effects_in_use

        return own_effects_in_use(self._own_effects)

    def _title(self, recording: Path) -> str:
        """The recording's file name for messages, with as many folders as tell it apart from the others."""
        name = self.names.get(recording, recording.stem)
        return str(Path(name).parent / recording.name) if "/" in name else recording.name

    def _vehicle_parts(self, *parts: str) -> dict[str, Any]:
        """Parts of the vehicle file that a stage depends on: keys such as `body.mass_kg`, or whole tables."""
        tables = self.vehicle.model_dump(mode="json", by_alias=True)
        split = {part: part.partition(".") for part in parts}
        return {part: tables[table][key] if key else tables[table] for part, (table, _, key) in split.items()}

    def _reusing(self) -> Pipeline:
        """This pipeline without fits and diagnoses that are not there: `NotMadeYet` is raised for such."""
        other = copy(self)
        other._makes_costly = False
        return other

    def find_fit(self, model: str) -> Artifact | None:
        """Artifact of a model that was fitted with the configuration's settings already; None where it was not."""
        try:
            return self._reusing().fit(model)
        except NotMadeYet:
            return None

    def find_diagnosis(self) -> Artifact | None:
        """Artifact of the diagnosis of the configuration's recordings; None where none was made of them as they are."""
        if not (self.config.diagnose and (self.config.workspace / "diagnose").is_dir()):
            return None
        try:
            return self._reusing().diagnose()
        except (NotMadeYet, InputRefused):
            return None

    def _with_loss(self, loss: CarLoss) -> Pipeline:
        """This pipeline with models fitted by `loss`; what is known of recordings is shared."""
        other = copy(self)
        other.config = self.config.with_loss(loss)
        return other

    def ingest(self, recording: Path) -> Artifact:
        """Artifact of one ingested recording: poses, commands and irregularities."""
        if recording not in self._ingested:
            self._ingested[recording] = self._ingest(recording)
        return self._ingested[recording]

    def _ingest(self, recording: Path) -> Artifact:
        """Artifact of one ingested recording, found by the content of its files."""
        file, cut = split_cut(recording)
        kind, commands = detect_format(file), find_commands_file(file, self.config.commands)
        tables = {"mcap": ("topics",), "motive": ("commands",), "table": ("columns", "commands")}[kind]
        inputs: dict[str, Any] = {
            "recording": "+".join(file_sha256(part) for part in recording_files(file)),
            "name": recording.name,
            "commands": file_sha256(commands) if commands is not None and commands.is_file() else None,
            "vehicle": self._vehicle_parts(*AXLE_KEYS, "steering", "motor", "mocap", "command", "clock", *tables),
        }

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import ingest

            ingest.run_ingest_stage(folder, file, commands, self.vehicle, self.config.allow_partial, cut)

        settings = {"allow_partial": True} if self.config.allow_partial else {}
        return self._run_stage("ingest", self._title(recording), inputs, settings, make)

    def raise_if_parts_lost(self) -> None:
        """Raise `PartLost` where a part of a recording that has been ingested so far could not be read."""
        from bcid.recording.saving import RecordingSummary

        ingested = [a.folder for a in self._known.values() if a.folder.parent.name == "ingest"]
        summaries = [RecordingSummary.read(folder / "recording.json") for folder in ingested]
        lost = [f"{s.name}: {i.detail}" for s in summaries for i in s.irregularities if i.kind == "lost"]
        if lost:
            raise PartLost(f"a part of the input is lost: {'; '.join(lost)}\n  next: repair or record it again")

    def refuse_unusable(self, recordings: Sequence[Path]) -> None:
        """Raise `InputRefused` where the check of a recording says no-go, with causes and next steps of all.

        Nothing is raised where the configuration says to ignore the recordings' health.
        """
        from bcid.recording.saving import RecordingSummary, load_recording

        problems = Problems()
        for recording in [] if self.config.ignore_health else dict.fromkeys(recordings):
            folder = self.ingest(recording).folder
            if recording in self._usable:
                continue
            if all(odd.action != "no-go" for odd in RecordingSummary.read(folder / "recording.json").irregularities):
                self._usable.add(recording)
                continue
            # it needs the checks, which are slow to import
            from bcid.recording.neighbours import name_fitting_commands

            for odd in name_fitting_commands(
                without_cut(recording), load_recording(folder), self.vehicle
            ).irregularities:
                if odd.action == "no-go":
                    cause, _, mend = odd.detail.rpartition("; ")
                    step = f"{mend} (or --ignore-health uses the take as it is)"
                    problems.append(Problem(odd.kind, f"no-go: {cause}", step, str(recording)))
        problems.raise_if_any(self.config.source)

    def _take_steps(self, recording: Path) -> TakeSteps:
        """The steps of a recording, by which it is known again under another name or in another format."""
        from bcid.evaluation.seen_takes import read_take_steps

        if recording not in self._steps:
            self._steps[recording] = read_take_steps(self.ingest(recording).folder)
        return self._steps[recording]

    def _refuse_repeats(self, recordings: Sequence[Path], against: Sequence[Path], place: str, next_step: str) -> None:
        """Raise `InputRefused` where one of `recordings` is of the drive of one `against` it, or of an earlier one."""
        refuse_repeats(recordings, against, self._take_steps, self.config.source, place, next_step)

    def tune(self) -> Artifact:
        """Artifact of the estimator's tuning to the training recordings.

        Raises:
            InputRefused: a training recording is given twice, which would count for two.
        """
        if self._tuned is None:
            self._tuned = self._tune()
        return self._tuned

    def _tune(self) -> Artifact:
        """Artifact of the tuning, found by the content of all training recordings."""
        self._refuse_repeats(self.config.training, (), "training", "name each take once")
        takes = [self.ingest(p) for p in self.config.training]
        table = self.config.estimate
        noise = {k: v for k, v in table.noise.model_dump().items() if v is not None}
        inputs = {"recordings": [a.content for a in takes], "vehicle": self._vehicle_parts(*ESTIMATOR_KEYS)}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s, "noise": noise}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import tune

            progress(0.0, "noise by likelihood")
            tune.run_tune_stage(folder, [a.folder for a in takes], self.vehicle, table.period_s, table.max_gap_s, noise)

        return self._run_stage("tune", "estimator", inputs, settings, make)

    def estimate(self, recording: Path) -> Artifact:
        """Artifact of the smoothed motion of one recording."""
        if recording not in self._estimated:
            self._estimated[recording] = self._estimate(recording)
        return self._estimated[recording]

    def _estimate(self, recording: Path) -> Artifact:
        """Artifact of the motion, found by the content of the recording and of all training recordings."""
        taken, tuned, table = self.ingest(recording), self.tune(), self.config.estimate
        vehicle = self._vehicle_parts(*ESTIMATOR_KEYS)
        inputs = {"recording": taken.content, "tuning": tuned.content, "vehicle": vehicle}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s, "engine": table.engine}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import estimate

            estimate.run_estimate_stage(
                folder, taken.folder, tuned.folder, self.vehicle, table.period_s, table.max_gap_s, table.engine
            )

        return self._run_stage("estimate", self._title(recording), inputs, settings, make)

    def check(self, recording: Path) -> Artifact | None:
        """Artifact of the estimator's errors against a simulated recording's truth; None where no truth is known."""
        if self.config.truth is None:
            return None
        if not self.config.truth.is_dir():
            raise InputRefused(self.config.source, "truth", f"{self.config.truth} is no folder", "correct or remove it")
        file, table = without_cut(recording), self.config.estimate
        truth = self.config.truth / f"{file.stem}.parquet"
        if not truth.exists():
            return None
        files = dict.fromkeys(without_cut(p) for p in self.config.recordings())
        alike = [p for p in files if p.stem == file.stem]
        if len(alike) > 1:
            cause = f"{truth} may be of any of {', '.join(map(str, alike))}"
            raise InputRefused(self.config.source, "truth", cause, "give the takes other names, or remove truth")
        taken, tuned, vehicle = self.ingest(recording), self.tune(), self._vehicle_parts(*ESTIMATOR_KEYS)
        content = {"recording": taken.content, "tuning": tuned.content, "truth": file_sha256(truth)}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import check

            check.run_check_stage(
                folder, taken.folder, tuned.folder, self.vehicle, table.period_s, table.max_gap_s, truth
            )

        return self._run_stage("check", self._title(recording), {**content, "vehicle": vehicle}, settings, make)

    def fit(self, model: str, **overrides: Any) -> Artifact:
        """Artifact of one model, fitted with the configuration's settings except for `overrides`."""
        row = fittable_row(model)
        self.refuse_unusable(self.config.training)
        base = self.fit(row.base, **row.base_settings) if row.base else None
        estimates = [self.estimate(p) for p in self.config.training]
        settings = self.config.fit_settings(model) | overrides
        takes = [self.ingest(p) for p in self.config.training] if settings.get("loss") == "poses" else []
        inputs = {
            "model": model,
            "estimates": [a.content for a in estimates],
            "recordings": [a.content for a in takes],
            "vehicle": self._vehicle_parts("body", "steering", "motor"),
            "base": base.content if base else None,
        }

        def make(folder: Path, progress: Progress) -> None:
            from bcid.evaluation.seen_takes import save_seen_takes
            from bcid.pipeline.stages import fit

            fit.run_fit_stage(
                folder, model, [a.folder for a in estimates], self.vehicle, settings, self.config.seed,
                base.folder if base else None, [a.folder for a in takes], progress,
            )  # fmt: skip
            save_seen_takes([self._take_steps(p) for p in self.config.training], folder)

        on = {"rollout": " on rollouts", "poses": " on poses"}.get(str(settings.get("loss")), "")
        modules = (row.module, SEEN_TAKES_MODULE)
        return self._run_stage("fit", f"{model}{on}", inputs, settings, make, *modules, seed=self.config.seed)

    def refuse_untrainable(self, models: Sequence[str]) -> None:
        """Raise `LibraryMissing` where one of `models` cannot be trained here, before the others take their time.

        A workspace that holds fits may hold these models', which need no training any more.
        """
        if not (self.config.workspace / "fit").is_dir():
            require_training_libraries(models)

    def fit_for_comparison(self, model: str) -> ComparedModel:
        """Fit one of the configuration's models for the comparison."""
        fit, settings = self.fit(model), self.config.fit_settings(model)
        return ComparedModel(model, fit.folder, fit.content, model_row(model).module, settings)

    def load_for_comparison(self, folder: Path) -> ComparedModel:
        """Load a model that was saved in `folder`, whatever made it, for a comparison.

        Raises:
            InputRefused: there is no model, or its period differs from `estimate.period_s` of the configuration.
        """
        from bcid.evaluation.validity import FILE_NAME as VALIDITY_FILE
        from bcid.models.saving import FILES, load_model

        with self.own_effects_of(folder):
            model, period_s = load_model(folder), self.config.estimate.period_s
        if abs(model.period_s - period_s) > LIMITS.max_period_difference_s:
            cause = f"steps by {model.period_s:g} s, but the pipeline's grid has {period_s:g} s"
            raise InputRefused(folder, "model.json", cause, f"set period_s = {model.period_s:g} in [estimate]")
        content = {name: file_sha256(folder / name) for name in (*FILES, VALIDITY_FILE) if (folder / name).exists()}
        return ComparedModel(model.name, folder, content, model_row(model.name).module, {})

    def _mark_if_seen(self, model: ComparedModel) -> ComparedModel:
        """A saved model with word of whether it was made from the validation take; where nobody knows, a note."""
        from bcid.evaluation.seen_takes import has_seen, load_seen_takes

        saw = has_seen(load_seen_takes(model.folder), self._take_steps(self._validation_recording()))
        if saw is None:
            self.watcher.note(f"{model.folder}: not known from which takes it was made; it may have seen this one")
        return model._replace(saw_validation=saw)

    def evaluate(self, model: ComparedModel) -> Artifact:
        """Artifact of one model's predictions of the validation recording, and their errors."""
        from bcid.models.saving import has_own_effects

        validation = self.estimate(self._validation_recording())
        training = [self.estimate(p) for p in self.config.training]
        settings = {"restart_s": self.config.report.restart_s}
        inputs = {"fit": model.content, "validation": validation.content, "training": [a.content for a in training]}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import evaluate

            takes = [a.folder for a in training]
            evaluate.run_evaluate_stage(folder, model.folder, validation.folder, takes, settings["restart_s"])

        own = has_own_effects(model.folder)
        return self._run_stage("evaluate", model.label, inputs, settings, make, model.module, own_effects=own)

    def validation_name(self) -> str | None:
        """What the validation recording is called where several are shown; None where none is named."""
        return self.names.get(self.config.validation) if self.config.validation else None

    def _validation_recording(self) -> Path:
        """Path of the validation recording; raise `InputRefused` where none is named."""
        if self.config.validation is None:
            next_step = 'add validation = "…" to the pipeline file'
            raise InputRefused(self.config.source, "validation", "no validation take is named", next_step)
        return self.config.validation

    def report(
        self, saved_models: Sequence[Path] = (), models: Sequence[str] | None = None, extent: ReportExtent = WHOLE
    ) -> Artifact:
        """Artifact of the comparison of `models`, by default all of the configuration's, and of `saved_models`.

        What the `extent` leaves out is in the report all the same where it is there already.
        """
        from bcid.models.saving import has_own_effects

        models = self.config.models if models is None else models
        self.refuse_untrainable(models)
        if extent.diagnosis and self.config.diagnose:
            self._refuse_unnamed_effects()
        self.refuse_unusable([*self.config.recordings(), *(self.config.diagnose if extent.diagnosis else ())])
        loaded = [self._mark_if_seen(self.load_for_comparison(folder)) for folder in dict.fromkeys(saved_models)]
        self._refuse_seen_validation()
        validation = self.estimate(self._validation_recording())
        candidates = label_uniquely([*(self.fit_for_comparison(m) for m in models), *loaded])
        judged = [(c, self.evaluate(c)) for c in candidates]
        if not judged:
            raise UsageError("the pipeline file names no models\n  next: list some in the pipeline file")
        settings = self.config.report.model_dump()
        compared = self._evaluate_losses(models, extent.losses)
        takes = [(self.ingest(p), self.estimate(p), self.check(p)) for p in self.config.recordings()]
        names = [self.names[p] for p in self.config.recordings()]
        diagnosis = self.diagnose() if extent.diagnosis and self.config.diagnose else self.find_diagnosis()
        origin = self._origin(self.config.recordings())
        inputs = {
            "diagnosis": diagnosis.content if diagnosis else None,
            "models": [[c.label, c.content, e.content, c.saw_validation] for c, e in judged],
            "losses": [[c.label, loss, e.content] for c, loss, e in compared],
            "takes": [[a.content if a else None for a in take] for take in takes],
            "names": names,
            "vehicle": self.vehicle.name,
            **self._origin_key(origin),
        }

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import report

            models = [
                report.EvaluatedModel(c.label, c.settings, c.folder, e.folder, c.saw_validation) for c, e in judged
            ]
            folders = [(r.folder, e.folder, check.folder if check else None) for r, e, check in takes]
            losses = [report.LossEvaluation(c.label, loss, e.folder) for c, loss, e in compared]
            report.run_report_stage(
                folder, models, validation.folder, folders, settings, self.vehicle.name,
                diagnosis.folder if diagnosis else None, losses, names, origin,
            )  # fmt: skip

        own = diagnosis is not None or any(has_own_effects(c.folder) for c in candidates)
        return self._run_stage(
            "report", "", inputs, settings, make, *(c.module for c in candidates), own_effects=own
        )  # fmt: skip

    def _refuse_seen_validation(self) -> None:
        """Raise `InputRefused` where the validation recording is of the drive of a training recording."""
        unseen = "name a take that no model is fitted on, or cut one take into two"
        self._refuse_repeats([self._validation_recording()], self.config.training, "validation", unseen)

    def score(self, model: ComparedModel) -> EvaluationDocument:
        """The closed-loop error of one model on the validation recording, the same as in the report.

        Raises:
            InputRefused: no validation take is named, it is no-go, or it is of the drive of a training take.
        """
        from bcid.documents.report import EvaluationDocument

        self.refuse_unusable([self._validation_recording()])
        self._refuse_seen_validation()
        return EvaluationDocument.read(self.evaluate(model).folder / "evaluation.json")

    def _evaluate_losses(self, models: Sequence[str], fits: bool) -> list[tuple[ComparedModel, str, Artifact]]:
        """Evaluate those of `models` that can be fitted by each loss that the report compares: model, loss, evaluation.

        Where not `fits`, only those that have been fitted by it already.
        """
        found = []
        for loss in self.config.report.losses:
            work = self._with_loss(loss)
            names = [m for m in models if loss in model_row(m).losses and (fits or work.find_fit(m))]
            found += [(c, str(loss), work.evaluate(c)) for c in (work.fit_for_comparison(m) for m in names)]
        return found

    def diagnose(self, simulation: str | None = None) -> Artifact:
        """Artifact of the diagnosis: what physics the recordings show that the base model, or `simulation`, lacks.

        `simulation` is a saved model's folder, a TOML file of parameters, another simulator's recording of the car, or
        module:function.
        """
        own_effects, recordings = self._own_effects, list(self.config.diagnose) or self.config.recordings()
        self.refuse_unusable([*recordings, *self.config.training])
        self._refuse_repeats(recordings, (), "diagnose", "name each take once: two would count as twice the evidence")
        takes, tuned = [(self.ingest(p), self.estimate(p)) for p in recordings], self.tune()
        path = Path(simulation) if simulation is not None else None
        recorded_too = path is not None and without_cut(path).is_file() and path.suffix != ".toml"
        others = [(self.ingest(path), self.estimate(path))] if path is not None and recorded_too else []
        names = [self.names[p] for p in recordings]
        inputs = {
            "takes": [[a.content for a in pair] for pair in takes],
            "tuning": tuned.content,
            "vehicle": self._vehicle_parts("body", "steering", "motor", "name"),
            "simulated": [[a.content for a in pair] for pair in others],
            "simulation": None if path is None or others else self._simulation_key(path),
            "names": names,
        }
        if own_effects is not None:
            inputs["effects"] = own_effects.sha256

        def make(folder: Path, progress: Progress) -> None:
            from bcid.evaluation.seen_takes import save_seen_takes
            from bcid.pipeline.stages import diagnose

            recorded, moved = ([pair[i].folder for pair in takes] for i in (0, 1))
            simulated = [(r.folder, e.folder) for r, e in others]
            diagnose.run_diagnose_stage(
                folder,
                recorded,
                moved,
                names,
                tuned.folder,
                self.vehicle,
                simulation,
                simulated,
                spread_rounds(progress),
            )
            save_seen_takes([self._take_steps(p) for p in recordings], folder / "model")

        return self._run_stage("diagnose", "", inputs, {}, make, SEEN_TAKES_MODULE, own_effects=True)

    def diagnosis_page(self, diagnosis: Artifact) -> Artifact:
        """Artifact of the page of a diagnosis of this pipeline's recordings, and of the card of its model.

        The page says when it was made and by which command, which do not count in its key: the page that was made first
        stays.
        """
        origin = self._origin(list(self.config.diagnose) or self.config.recordings())
        inputs = {"diagnosis": diagnosis.content, **self._origin_key(origin)}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import diagnosis_page

            diagnosis_page.run_diagnosis_page_stage(folder, diagnosis.folder, origin)

        return self._run_stage("diagnosis_page", "", inputs, {}, make, own_effects=True)

    def _origin(self, recordings: Sequence[Path]) -> Origin:
        """Where a result that was made from these recordings comes from, for its card."""
        from bcid.documents.model_card import DataFile
        from bcid.pipeline.model_card import IngestedTake, Origin
        from bcid.recording.recorded_on import recorded_on

        path = self.config.vehicle
        taken = [
            IngestedTake(self.ingest(p).folder, self._title(p).removesuffix(p.name), recorded_on(p)) for p in recordings
        ]
        return Origin(
            self.vehicle.name, DataFile(name=path.name, sha256=file_sha256(path), format="toml"), taken,
            self.config.command,
        )  # fmt: skip

    @staticmethod
    def _origin_key(origin: Origin) -> dict[str, Any]:
        """What of an origin counts in the key of what is made from it: the content of files, and dates in them."""
        takes = [[take.parents, take.recorded] for take in origin.recordings]
        return {"vehicle_file": [origin.vehicle_file.name, origin.vehicle_file.sha256], "recorded": takes}

    def _simulation_key(self, simulation: Path) -> Any:
        """What stands for a simulation in a key: digests of its files, or the name and file of a module.

        A module is not cached reliably, since what it imports is not seen.
        """
        if simulation.is_dir():
            return self.load_for_comparison(simulation).content
        if simulation.is_file():
            return file_sha256(simulation)
        module = Path(str(simulation).partition(":")[0].replace(".", "/") + ".py")
        return [str(simulation), file_sha256(module) if module.is_file() else None]

    def publish(self, artifact: Artifact, *names: str, to: str) -> Path:
        """Copy an artifact's files and folders to WORKSPACE/`to`, as `publish_copies` does; return the first copy."""
        home = self.config.workspace / to
        if are_published(artifact.folder, names, home):
            return home / names[0]
        with self.store.exclusive_lock("publish"):
            known = artifact_digests(self.config.workspace)
            return publish_copies(artifact.folder, names, home, known, self.config.force)

    def publish_fit(self, fit: Artifact, name: str) -> Path:
        """Copy a fitted model to WORKSPACE/models/`name`, where it is found by that name; returns the copy's folder."""
        return self.publish(fit, *MODEL_FILES, to=f"{MODELS_FOLDER}/{name}").parent

    def refuse_to_publish_over(self, *names: str, to: str) -> None:
        """Raise `InputRefused` where `publish` would refuse, so that nobody waits for what cannot be published."""
        known = artifact_digests(self.config.workspace)
        refuse_to_replace(names, self.config.workspace / to, known, self.config.force)


def label_uniquely(candidates: Sequence[ComparedModel]) -> list[ComparedModel]:
    """Compared models with unique labels: a repeated label gets " (PARENT/NAME)" of the model's folder appended."""
    names = [c.label for c in candidates]
    return [
        c._replace(label=f"{c.label} ({'/'.join(c.folder.parts[-2:])})")
        if names.count(c.label) > 1 and names.index(c.label) < i
        else c
        for i, c in enumerate(candidates)
    ]

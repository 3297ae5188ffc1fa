"""The stages of a plan, each run when it is first needed and reused where it is cached."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Protocol

from bcid.errors import InputRefused, UsageError
from bcid.models.table import row_of
from bcid.pipeline.plan import Plan
from bcid.store.artifact import Artifact, Recipe, Store, sha256_of
from bcid.store.code import code_of
from bcid.vehicle import read_vehicle

Progress = Callable[[float, str], None]
_STAGES = "bcid.pipeline.stages"


class Watcher(Protocol):
    """Who is told of the stages: each is entered when it starts, and told whether it was reused."""

    def stage(self, title: str) -> AbstractContextManager[Progress]:
        """A stage that is about to be made."""

    def reused(self, title: str) -> None:
        """A stage that was found in the cache."""


class Silent:
    """A watcher that says nothing."""

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        """See `Watcher`."""
        yield lambda share, text: None

    def reused(self, title: str) -> None:
        """See `Watcher`."""


class Pipeline:
    """The artifacts of one plan."""

    def __init__(self, plan: Plan, watcher: Watcher | None = None) -> None:
        self.plan = plan
        self.vehicle = read_vehicle(plan.vehicle)
        self.store = Store(plan.workspace)
        self.watcher = watcher or Silent()
        self._known: dict[str, Artifact] = {}
        self._vehicle = self.vehicle.model_dump(mode="json", by_alias=True)

    def _get(self, title: str, recipe: Recipe, make: Callable[[Path, Progress], None]) -> Artifact:
        if recipe.key in self._known:
            return self._known[recipe.key]

        def watched(folder: Path) -> None:
            with self.watcher.stage(title) as progress:
                make(folder, progress)

        artifact = self.store.get(recipe, watched)
        if artifact.reused:
            self.watcher.reused(title)
        self._known[recipe.key] = artifact
        return artifact

    def takes(self) -> list[Path]:
        """All recordings of the plan, validation last."""
        plan = self.plan
        return [*plan.training, *([plan.validation] if plan.validation else [])]

    def ingest(self, recording: Path) -> Artifact:
        """One recording."""
        commands = self._commands_of(recording)
        if not recording.is_file():
            from bcid.recording.raw import source_of

            source_of(recording, "")  # says what is wrong with it
        inputs: dict[str, Any] = {"recording": sha256_of(recording), "name": recording.name, "vehicle": self._vehicle}
        if commands is not None and commands.is_file():
            inputs["commands"] = sha256_of(commands)
        code = code_of(f"{_STAGES}.ingest")

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import ingest

            ingest.make(folder, recording, commands, self.vehicle)

        return self._get(f"ingest {recording.name}", Recipe("ingest", inputs, {}, code), make)

    def _commands_of(self, recording: Path) -> Path | None:
        if recording.suffix.lower() != ".csv":
            return None
        return self.plan.commands or recording.with_suffix(".commands.csv")

    def tune(self) -> Artifact:
        """The estimator's constants, from the training takes."""
        takes = [self.ingest(p) for p in self.plan.training]
        table = self.plan.estimate
        noise = {k: v for k, v in table.noise.model_dump().items() if v is not None}
        inputs = {"recordings": [a.key for a in takes], "vehicle": self._vehicle}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s, "noise": noise}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import tune

            progress(0.0, "noise by likelihood")
            tune.make(folder, [a.folder for a in takes], self.vehicle, table.period_s, table.max_gap_s, noise)

        return self._get("tune estimator", Recipe("tune", inputs, settings, code_of(f"{_STAGES}.tune")), make)

    def estimate(self, recording: Path) -> Artifact:
        """The smoothed motion of one recording."""
        taken, tuned, table = self.ingest(recording), self.tune(), self.plan.estimate
        truth = self.plan.truth / f"{recording.stem}.parquet" if self.plan.truth else None
        truth = truth if truth and truth.exists() else None
        inputs = {
            "recording": taken.key, "tuning": tuned.key, "vehicle": self._vehicle, "truth": truth and sha256_of(truth),
        }  # fmt: skip
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s, "engine": table.engine}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import estimate

            estimate.make(
                folder, taken.folder, tuned.folder, self.vehicle, table.period_s, table.max_gap_s, table.engine, truth
            )  # fmt: skip

        code = code_of(f"{_STAGES}.estimate")
        return self._get(f"estimate {recording.name}", Recipe("estimate", inputs, settings, code), make)

    def fit(self, model: str) -> Artifact:
        """One fitted model."""
        row = row_of(model)
        base = self.fit(row.base) if row.base else None
        estimates = [self.estimate(p) for p in self.plan.training]
        settings = self.plan.fit_settings(model)
        inputs = {
            "model": model,
            "estimates": [a.key for a in estimates],
            "vehicle": self._vehicle,
            "base": base.key if base else None,
        }
        recipe = Recipe("fit", inputs, settings, code_of(f"{_STAGES}.fit", row.module), self.plan.seed)

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import fit

            folders = [a.folder for a in estimates]
            base_folder = base.folder if base else None
            fit.make(folder, model, folders, self.vehicle, settings, self.plan.seed, base_folder, progress)

        return self._get(f"fit {model}", recipe, make)

    def evaluate(self, model: str) -> Artifact:
        """One model on the validation take."""
        fitted, validation = self.fit(model), self.estimate(self._validation())
        training = [self.estimate(p) for p in self.plan.training]
        settings = {"restart_s": self.plan.report.restart_s}
        inputs = {"fit": fitted.key, "validation": validation.key, "training": [a.key for a in training]}
        recipe = Recipe("evaluate", inputs, settings, code_of(f"{_STAGES}.evaluate", row_of(model).module))

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import evaluate

            evaluate.make(folder, fitted.folder, validation.folder, [a.folder for a in training], settings["restart_s"])

        return self._get(f"evaluate {model}", recipe, make)

    def _validation(self) -> Path:
        if self.plan.validation is None:
            raise InputRefused(
                self.plan.source,
                "validation",
                "no validation take is named",
                'add validation = "…" to the pipeline file',
            )
        return self.plan.validation

    def report(self) -> Artifact:
        """The comparison of all the plan's models."""
        validation = self.estimate(self._validation())
        judged = [(self.fit(m), self.evaluate(m)) for m in self.plan.models]
        if not judged:
            raise UsageError("the plan names no models\n  next: list some in the pipeline file")
        settings = self.plan.report.model_dump()
        estimates = [self.estimate(p) for p in self.takes()]
        recordings = [self.ingest(p) for p in self.takes()]
        inputs = {
            "models": [[f.key, e.key] for f, e in judged],
            "estimates": [a.key for a in estimates],
            "vehicle": self.vehicle.name,
        }
        roots = [row_of(m).module for m in self.plan.models]

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import report

            report.make(
                folder, [(f.folder, e.folder) for f, e in judged], validation.folder, [a.folder for a in estimates],
                [a.folder for a in recordings], settings, self.vehicle.name,
            )  # fmt: skip

        return self._get("report", Recipe("report", inputs, settings, code_of(f"{_STAGES}.report", *roots)), make)

    def publish(self, artifact: Artifact) -> Path:
        """Copy a report's page and JSON to where they are looked for, WORKSPACE/report/; returns the page."""
        for name in ("index.html", "report.json"):
            target = self.plan.workspace / "report" / name
            beside = target.with_name(f".{name}.{artifact.key}")
            shutil.copyfile(artifact.folder / name, beside)
            beside.replace(target)
        return self.plan.workspace / "report" / "index.html"

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
from bcid.recording.formats import commands_of, format_of
from bcid.store.artifact import Artifact, Recipe, Store, sha256_of
from bcid.store.code import code_of
from bcid.vehicle import read_vehicle

Progress = Callable[[float, str], None]
_STAGES = "bcid.pipeline.stages"
GEOMETRY = ("body.cog_to_front_m", "body.cog_to_rear_m")
DRIVEN = (*GEOMETRY, "body.drive", "body.front_drive_share")


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

    def _of_vehicle(self, *parts: str) -> dict[str, Any]:
        """Those parts of the vehicle file that a stage looks at (`body.mass_kg`, or a whole table)."""
        whole = self.vehicle.model_dump(mode="json", by_alias=True)
        picked = {}
        for part in parts:
            table, _, key = part.partition(".")
            picked[part] = whole[table][key] if key else whole[table]
        return picked

    def ingest(self, recording: Path) -> Artifact:
        """One recording."""
        kind, commands = format_of(recording), commands_of(recording, self.plan.commands)
        tables = {"mcap": ("topics",), "motive": (), "table": ("columns",)}[kind]
        inputs: dict[str, Any] = {
            "recording": sha256_of(recording),
            "name": recording.name,
            "commands": sha256_of(commands) if commands is not None and commands.is_file() else None,
            "vehicle": self._of_vehicle(*GEOMETRY, "steering", "motor", "mocap", "command", "clock", *tables),
        }

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import ingest

            ingest.make(folder, recording, commands, self.vehicle)

        return self._get(f"ingest {recording.name}", Recipe("ingest", inputs, {}, code_of(f"{_STAGES}.ingest")), make)

    def tune(self) -> Artifact:
        """The estimator's constants, from the training takes."""
        takes = [self.ingest(p) for p in self.plan.training]
        table = self.plan.estimate
        noise = {k: v for k, v in table.noise.model_dump().items() if v is not None}
        inputs = {"recordings": [a.content for a in takes], "vehicle": self._of_vehicle(*DRIVEN, "steering")}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s, "noise": noise}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import tune

            progress(0.0, "noise by likelihood")
            tune.make(folder, [a.folder for a in takes], self.vehicle, table.period_s, table.max_gap_s, noise)

        return self._get("tune estimator", Recipe("tune", inputs, settings, code_of(f"{_STAGES}.tune")), make)

    def estimate(self, recording: Path) -> Artifact:
        """The smoothed motion of one recording."""
        taken, tuned, table = self.ingest(recording), self.tune(), self.plan.estimate
        vehicle = self._of_vehicle(*DRIVEN, "steering")
        inputs = {"recording": taken.content, "tuning": tuned.content, "vehicle": vehicle}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s, "engine": table.engine}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import estimate

            where = (taken.folder, tuned.folder)
            estimate.make(folder, *where, self.vehicle, table.period_s, table.max_gap_s, table.engine)

        code = code_of(f"{_STAGES}.estimate")
        return self._get(f"estimate {recording.name}", Recipe("estimate", inputs, settings, code), make)

    def check(self, recording: Path) -> Artifact | None:
        """The estimator against the truth of a simulated take; None where the plan names no truth for it."""
        if self.plan.truth is None:
            return None
        if not self.plan.truth.is_dir():
            raise InputRefused(self.plan.source, "truth", f"{self.plan.truth} is no folder", "correct or remove it")
        truth, table = self.plan.truth / f"{recording.stem}.parquet", self.plan.estimate
        if not truth.exists():
            return None
        taken, tuned = self.ingest(recording), self.tune()
        vehicle = self._of_vehicle(*DRIVEN, "steering")
        content = {"recording": taken.content, "tuning": tuned.content}
        inputs = {**content, "vehicle": vehicle, "truth": sha256_of(truth)}
        settings = {"period_s": table.period_s, "max_gap_s": table.max_gap_s}

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import check

            check.make(folder, taken.folder, tuned.folder, self.vehicle, table.period_s, table.max_gap_s, truth)

        code = code_of(f"{_STAGES}.check")
        return self._get(f"check {recording.name}", Recipe("check", inputs, settings, code), make)

    def fit(self, model: str) -> Artifact:
        """One fitted model."""
        row = row_of(model)
        base = self.fit(row.base) if row.base else None
        estimates = [self.estimate(p) for p in self.plan.training]
        settings = self.plan.fit_settings(model)
        inputs = {
            "model": model,
            "estimates": [a.content for a in estimates],
            "vehicle": self._of_vehicle("body", "steering", "motor"),
            "base": base.content if base else None,
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
        inputs = {
            "fit": fitted.content,
            "validation": validation.content,
            "training": [a.content for a in training],
        }
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
        takes = [(self.ingest(p), self.estimate(p), self.check(p)) for p in self.takes()]
        inputs = {
            "models": [[f.content, e.content] for f, e in judged],
            "takes": [[a.content if a else None for a in take] for take in takes],
            "vehicle": self.vehicle.name,
        }
        roots = [row_of(m).module for m in self.plan.models]

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import report

            models = [(f.folder, e.folder) for f, e in judged]
            folders = [tuple(a.folder if a else None for a in take) for take in takes]
            report.make(folder, models, validation.folder, folders, settings, self.vehicle.name)

        return self._get("report", Recipe("report", inputs, settings, code_of(f"{_STAGES}.report", *roots)), make)

    def publish(self, artifact: Artifact) -> Path:
        """Copy a report's page and JSON to where they are looked for, WORKSPACE/report/; returns the page."""
        for name in ("index.html", "report.json"):
            target = self.plan.workspace / "report" / name
            beside = target.with_name(f".{name}.{artifact.key}")
            shutil.copyfile(artifact.folder / name, beside)
            beside.replace(target)
        return self.plan.workspace / "report" / "index.html"

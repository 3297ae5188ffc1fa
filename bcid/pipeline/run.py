"""The stages of a plan, each run when it is first needed and reused where it is cached."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bcid.aliases import Progress
from bcid.errors import InputRefused, UsageError
from bcid.files.source_code import code_of
from bcid.models.table import row_of, row_to_fit
from bcid.pipeline.plan import Plan
from bcid.pipeline.publishing import publish_copies
from bcid.pipeline.watching import Silent, Watcher
from bcid.recording.formats.detect import commands_of, format_of, parts_of
from bcid.store.artifact import Artifact, Recipe, Store, sha256_of
from bcid.vehicle import read_vehicle

_STAGES = "bcid.pipeline.stages"
WAITING = "waiting for another run, which is at work in {}"
GEOMETRY = ("body.cog_to_front_m", "body.cog_to_rear_m")
DRIVEN = (*GEOMETRY, "body.drive", "body.front_drive_share")


class Candidate(NamedTuple):
    """A model for the comparison, fitted here or saved anywhere."""

    label: str
    folder: Path
    content: Any  # digests of its files
    module: str
    settings: Mapping[str, Any]  # of its fit


class Pipeline:
    """The artifacts of one plan."""

    def __init__(self, plan: Plan, watcher: Watcher | None = None) -> None:
        self.plan = plan
        self.vehicle = read_vehicle(plan.vehicle)
        self.watcher = watcher or Silent()
        self.store = Store(plan.workspace, lambda: self.watcher.note(WAITING.format(plan.workspace)))
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
            "recording": "+".join(sha256_of(part) for part in parts_of(recording)),
            "name": recording.name,
            "commands": sha256_of(commands) if commands is not None and commands.is_file() else None,
            "vehicle": self._of_vehicle(*GEOMETRY, "steering", "motor", "mocap", "command", "clock", *tables),
        }

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import ingest

            ingest.make(folder, recording, commands, self.vehicle, self.plan.allow_partial)

        settings = {"allow_partial": True} if self.plan.allow_partial else {}
        recipe = Recipe("ingest", inputs, settings, code_of(f"{_STAGES}.ingest"))
        return self._get(f"ingest {recording.name}", recipe, make)

    def lost(self) -> list[str]:
        """What of the recordings read so far could not be read."""
        facts = [a.json("recording.json") for a in self._known.values() if a.folder.parent.name == "ingest"]
        return [f"{f['name']}: {i['detail']}" for f in facts for i in f["irregularities"] if i["kind"] == "lost"]

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

    def fit(self, model: str, **otherwise: Any) -> Artifact:
        """One fitted model, with the plan's settings but for those given `otherwise`."""
        row = row_to_fit(model)
        base = self.fit(row.base, **row.base_settings) if row.base else None
        estimates = [self.estimate(p) for p in self.plan.training]
        settings = self.plan.fit_settings(model) | otherwise
        takes = [self.ingest(p) for p in self.plan.training] if settings.get("loss") == "poses" else []
        inputs = {
            "model": model,
            "estimates": [a.content for a in estimates],
            "recordings": [a.content for a in takes],
            "vehicle": self._of_vehicle("body", "steering", "motor"),
            "base": base.content if base else None,
        }
        recipe = Recipe("fit", inputs, settings, code_of(f"{_STAGES}.fit", row.module), self.plan.seed)

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import fit

            folders, recorded = [a.folder for a in estimates], [a.folder for a in takes]
            base_folder = base.folder if base else None
            fit.make(folder, model, folders, self.vehicle, settings, self.plan.seed, base_folder, recorded, progress)

        on = {"rollout": " on rollouts", "poses": " on poses"}.get(str(settings.get("loss")), "")
        return self._get(f"fit {model}{on}", recipe, make)

    def fitted(self, model: str) -> Candidate:
        """One fitted model."""
        artifact = self.fit(model)
        return Candidate(
            model, artifact.folder, artifact.content, row_of(model).module, self.plan.fit_settings(model)
        )  # fmt: skip

    def saved(self, folder: Path) -> Candidate:
        """A model that was saved in `folder`, whatever made it.

        Raises:
            InputRefused: no model there, or one that steps by another period than the plan's.
        """
        from bcid.evaluation.limits import FILE as LIMITS
        from bcid.models.saving import FILES, load_model

        model, period_s = load_model(folder), self.plan.estimate.period_s
        if abs(model.period_s - period_s) > 1e-9:
            cause = f"steps by {model.period_s:g} s, but the plan's grid has {period_s:g} s"
            raise InputRefused(folder, "model.json", cause, f"set period_s = {model.period_s:g} in [estimate]")
        content = {name: sha256_of(folder / name) for name in (*FILES, LIMITS) if (folder / name).exists()}
        return Candidate(model.name, folder, content, row_of(model.name).module, {})

    def evaluate(self, candidate: Candidate) -> Artifact:
        """One model on the validation take."""
        validation = self.estimate(self._validation())
        training = [self.estimate(p) for p in self.plan.training]
        settings = {"restart_s": self.plan.report.restart_s}
        inputs = {
            "fit": candidate.content,
            "validation": validation.content,
            "training": [a.content for a in training],
        }
        recipe = Recipe("evaluate", inputs, settings, code_of(f"{_STAGES}.evaluate", candidate.module))

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import evaluate

            where = (candidate.folder, validation.folder, [a.folder for a in training])
            evaluate.make(folder, *where, settings["restart_s"])

        return self._get(f"evaluate {candidate.label}", recipe, make)

    def _validation(self) -> Path:
        if self.plan.validation is None:
            raise InputRefused(
                self.plan.source,
                "validation",
                "no validation take is named",
                'add validation = "…" to the pipeline file',
            )
        return self.plan.validation

    def report(self, extra: Sequence[Path] = ()) -> Artifact:
        """The comparison of all the plan's models, and of those saved in the folders `extra`."""
        joining = [self.saved(folder) for folder in dict.fromkeys(extra)]
        validation = self.estimate(self._validation())
        candidates = told_apart([*(self.fitted(m) for m in self.plan.models), *joining])
        judged = [(c, self.evaluate(c)) for c in candidates]
        if not judged:
            raise UsageError("the plan names no models\n  next: list some in the pipeline file")
        settings = self.plan.report.model_dump()
        compared = self._by_loss()
        takes = [(self.ingest(p), self.estimate(p), self.check(p)) for p in self.takes()]
        diagnosis = self.diagnose() if self.plan.diagnose else None
        inputs = {
            "diagnosis": diagnosis.content if diagnosis else None,
            "models": [[c.label, c.content, e.content] for c, e in judged],
            "losses": [[c.label, loss, e.content] for c, loss, e in compared],
            "takes": [[a.content if a else None for a in take] for take in takes],
            "vehicle": self.vehicle.name,
        }
        roots = [c.module for c in candidates]

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import report

            models = [report.Judged(c.label, c.settings, c.folder, e.folder) for c, e in judged]
            folders = [tuple(a.folder if a else None for a in take) for take in takes]
            where = diagnosis.folder if diagnosis else None
            losses = [report.ByLoss(c.label, loss, e.folder) for c, loss, e in compared]
            report.make(folder, models, validation.folder, folders, settings, self.vehicle.name, where, losses)

        return self._get("report", Recipe("report", inputs, settings, code_of(f"{_STAGES}.report", *roots)), make)

    def _by_loss(self) -> list[tuple[Candidate, str, Artifact]]:
        """The plan's models fitted by each of the losses that the report compares, with the same seed, and judged."""
        found = []
        for loss in self.plan.report.losses:
            work = Pipeline(self.plan.with_loss(loss), self.watcher)
            names = [m for m in self.plan.models if loss in row_of(m).losses]
            found += [(c, str(loss), work.evaluate(c)) for c in (work.fitted(m) for m in names)]
        return found

    def diagnose(self, simulation: str | None = None) -> Artifact:
        """What physics the plan's recordings show that the base model, or `simulation`, lacks.

        `simulation` is a saved model's folder, a TOML file of parameters, another simulator's recording, or
        module:function.
        """
        recordings = list(self.plan.diagnose) or self.takes()
        takes, tuned = [(self.ingest(p), self.estimate(p)) for p in recordings], self.tune()
        path = Path(simulation) if simulation is not None else None
        recorded_too = path is not None and path.is_file() and path.suffix != ".toml"
        others = [(self.ingest(path), self.estimate(path))] if path is not None and recorded_too else []
        inputs = {
            "takes": [[a.content for a in pair] for pair in takes],
            "tuning": tuned.content,
            "vehicle": self._of_vehicle("body", "steering", "motor", "name"),
            "simulated": [[a.content for a in pair] for pair in others],
            "simulation": None if path is None or others else self._named(path),
        }
        recipe = Recipe("diagnose", inputs, {}, code_of(f"{_STAGES}.diagnose"))

        def make(folder: Path, progress: Progress) -> None:
            from bcid.pipeline.stages import diagnose

            recorded, moved = ([pair[i].folder for pair in takes] for i in (0, 1))
            simulated = [(r.folder, e.folder) for r, e in others]
            diagnose.make(folder, recorded, moved, tuned.folder, self.vehicle, simulation, simulated, progress)

        return self._get("diagnose", recipe, make)

    def _named(self, simulation: Path) -> Any:
        """What stands for a simulation in a key: its files' digests, or its name, which is not cached reliably."""
        if simulation.is_dir():
            return self.saved(simulation).content
        if simulation.is_file():
            return sha256_of(simulation)
        module = Path(str(simulation).partition(":")[0].replace(".", "/") + ".py")
        return [str(simulation), sha256_of(module) if module.is_file() else None]

    def publish(self, artifact: Artifact, *names: str, to: str) -> Path:
        """Copy an artifact's files and folders to WORKSPACE/`to`, where they are looked for; returns the first.

        Raises:
            UsageError: where a folder of such a name holds something else than a saved model.
        """
        with self.store.alone("publish"):
            return publish_copies(artifact.folder, names, self.plan.workspace / to)


def told_apart(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, those saved elsewhere with their folder's end in the label where the name is another's too."""
    names = [c.label for c in candidates]
    return [
        c._replace(label=f"{c.label} ({'/'.join(c.folder.parts[-2:])})")
        if names.count(c.label) > 1 and names.index(c.label) < i
        else c
        for i, c in enumerate(candidates)
    ]

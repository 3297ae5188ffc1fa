"""The pipeline file: which recordings and models, with which settings."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model

from bcid.errors import InputRefused, Problem, Problems
from bcid.estimate.limits import LIMITS
from bcid.files.toml import BACKSLASHES, PathText, Settings, read_toml
from bcid.models.settings import CarLoss
from bcid.models.table import FITTABLE

NoiseValue = Annotated[float, Field(ge=LIMITS.min_noise, le=LIMITS.max_noise)]


class NoiseTable(Settings):
    """Square roots of spectral densities and standard deviations of sensors; those that are absent are identified."""

    q_v_f: NoiseValue | None = None
    q_beta_f: NoiseValue | None = None
    q_beta_r: NoiseValue | None = None
    q_delta: NoiseValue | None = None
    r_position: NoiseValue | None = None
    r_yaw: NoiseValue | None = None
    r_steering: NoiseValue | None = None
    r_yaw_rate: NoiseValue | None = None
    r_wheel_speed: NoiseValue | None = None


class EstimateTable(Settings):
    """Settings of the estimator: the table `[estimate]` of a pipeline file."""

    period_s: Annotated[float, Field(ge=LIMITS.min_period_s, le=LIMITS.max_period_s)] = 0.1
    max_gap_s: Annotated[float, Field(gt=0)] = 0.3
    engine: Literal["compiled", "filterpy"] = "compiled"
    noise: NoiseTable = NoiseTable()


class PublishedTable(Settings):
    """Figures that others published of models of the same names: the table `[report.published]` of a pipeline file."""

    title: Annotated[str, Field(min_length=1)]
    note: str = ""  # on what data and machine they were found
    nmse: Annotated[dict[str, Annotated[float, Field(gt=0)]], Field(min_length=1)]  # by model
    rollout_ms: dict[str, Annotated[float, Field(gt=0)]] = Field(default_factory=dict)


class ReportTable(Settings):
    """Settings of the report: the table `[report]` of a pipeline file."""

    restart_s: Annotated[float, Field(gt=0)] = 2.0
    timing_repeats: Annotated[int, Field(ge=0)] = 21  # 0: not timed; equal runs on one machine have equal reports
    losses: list[CarLoss] = Field(default_factory=list)  # that are compared, beside the comparison of models
    published: PublishedTable | None = None  # shown beside ours; null where nobody published any of this car


def _field_name(model: str) -> str:
    """Python name of the field of `FitTables` that holds a model's settings: "k_mlp" for the model "k-mlp"."""
    return model.replace("-", "_")


_FIELDS: dict[str, Any] = {
    _field_name(name): (row.settings, Field(default_factory=row.settings, alias=name)) for name, row in FITTABLE.items()
}
FitTables = create_model("FitTables", __base__=Settings, **_FIELDS)
"""One table of settings for each model, `[fit.NAME]`."""


def _check_model_name(name: str) -> str:
    """Return `name` if it is the name of a model that can be fitted; raise `ValueError` for any other."""
    if name not in FITTABLE:
        raise ValueError(f"there is no model {name!r} to fit; choose from {', '.join(FITTABLE)}")
    return name


class PipelineFile(Settings):
    """A pipeline file as it stands; its paths count from the file's folder."""

    vehicle: PathText
    training: Annotated[list[PathText], Field(min_length=1)]
    validation: PathText | None = None
    truth: PathText | None = None  # folder of NAME.parquet, simulated takes only
    workspace: PathText = Path("workspace")
    seed: int = 1
    models: list[Annotated[str, AfterValidator(_check_model_name)]] = Field(default_factory=lambda: list(FITTABLE))
    estimate: EstimateTable = EstimateTable()
    diagnose: list[PathText] = Field(default_factory=list)  # recordings; empty: those of training
    effects: PathText | None = None  # a Python file of the user's own effects
    fit: FitTables = Field(default_factory=FitTables)
    report: ReportTable = ReportTable()


class PipelineConfig(PipelineFile):
    """A checked pipeline file, or what the command line says in its place, with paths as they are to be opened."""

    source: str  # where this configuration stands, for messages
    commands: PathText | None = None  # of a single recording named on the command line
    allow_partial: bool = False  # recordings of which a part cannot be read are used without it
    ignore_health: bool = False  # recordings whose check says no-go are used all the same
    command: str = ""  # the command line that asked for it, for the cards of what is made
    effects_named: bool = True  # False where a pipeline file that was only found names `effects`: they are not run
    force: bool = False  # results replace files where they are published, whoever wrote those

    def recordings(self) -> list[Path]:
        """The training recordings, then the validation recording if there is one."""
        return [*self.training, *([self.validation] if self.validation else [])]

    def with_loss(self, loss: CarLoss) -> PipelineConfig:
        """This configuration with `loss` for every model that can be fitted by it."""
        names = [_field_name(model) for model, row in FITTABLE.items() if loss in row.losses]
        tables = {name: getattr(self.fit, name).model_copy(update={"loss": loss}) for name in names}
        return self.model_copy(update={"fit": self.fit.model_copy(update=tables)})

    def for_recording(self, home: Path, recording: Path, unseen: Path | None = None) -> PipelineConfig:
        """This configuration for one recording, as a command makes it where that is named alone.

        Relative paths count from the folder `home`, and are absolute in what is returned, so that they hold in every
        process; the recording `unseen` is to be predicted.
        """
        places = {name: getattr(self, name) for name in ("vehicle", "workspace", "effects", "commands")}
        return self.model_copy(update={
            "training": [home / recording], "validation": unseen and home / unseen, "truth": None, "diagnose": [],
            **{name: path and home / path for name, path in places.items()},
        })  # fmt: skip

    def fit_settings(self, model: str) -> dict[str, Any]:
        """Settings of a model's fit, the model's defaults among them, as JSON data."""
        return dict(getattr(self.fit, _field_name(model)).model_dump(mode="json", by_alias=True))


def _refuse_backslashes(path: Path, file: PipelineFile) -> None:
    r"""Raise `InputRefused` where a recording or file is named that is not there, and backslashes are the likely cause.

    In double quotes `\t` is a tab; elsewhere than on Windows a backslash parts no folders.
    """
    named = {"vehicle": [file.vehicle], "training": file.training, "diagnose": file.diagnose}
    named |= {"validation": [file.validation] if file.validation else []}
    problems = Problems()
    for key, paths in named.items():
        for text in map(str, paths):
            if (path.parent / text).exists() or (text.isprintable() and ("\\" not in text or os.sep == "\\")):
                continue
            control = not text.isprintable()
            cause = "holds a control character, such as \\t in double quotes" if control else "holds backslashes"
            problems.append(Problem(key, f"{text!r} is not there, and {cause}", BACKSLASHES))
    problems.raise_if_any(path)


def read_pipeline_file(path: Path) -> PipelineConfig:
    """Read and check the pipeline file at `path`; its relative paths are taken from the file's folder.

    Raises:
        InputRefused: the file is absent or has wrong entries; the message names all of them.
    """
    if not path.exists():
        next_step = "write one with `bcid init`, or name one with -p"
        raise InputRefused(path, "pipeline file", "there is none here", next_step)
    file = read_toml(path, PipelineFile, "pipeline file")
    _refuse_backslashes(path, file)

    def at(named: Path) -> Path:
        return Path(os.path.normpath(path.parent / named))

    single = ("vehicle", "validation", "truth", "workspace", "effects")
    paths: dict[str, Any] = {name: getattr(file, name) for name in single}
    opened = {name: named and at(named) for name, named in paths.items()}
    opened |= {"training": [at(p) for p in file.training], "diagnose": [at(p) for p in file.diagnose]}
    return PipelineConfig(**{**dict(file), **opened, "source": str(path)})

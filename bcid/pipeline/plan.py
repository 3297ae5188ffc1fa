"""The pipeline file: which recordings, which models, with what settings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model

from bcid.errors import InputRefused
from bcid.files.toml import Settings, read_toml
from bcid.models.settings import CarLoss
from bcid.models.table import FITTED

DEFAULT = Path("pipelines/bumper_car.toml")


class NoiseTable(Settings):
    """Square roots of spectral densities and sensors' standard deviations; what is absent is identified."""

    q_v_f: Annotated[float, Field(gt=0)] | None = None
    q_beta_f: Annotated[float, Field(gt=0)] | None = None
    q_beta_r: Annotated[float, Field(gt=0)] | None = None
    q_delta: Annotated[float, Field(gt=0)] | None = None
    r_position: Annotated[float, Field(gt=0)] | None = None
    r_yaw: Annotated[float, Field(gt=0)] | None = None
    r_steering: Annotated[float, Field(gt=0)] | None = None
    r_yaw_rate: Annotated[float, Field(gt=0)] | None = None
    r_wheel_speed: Annotated[float, Field(gt=0)] | None = None


class EstimateTable(Settings):
    """The estimator."""

    period_s: Annotated[float, Field(gt=0, le=1)] = 0.1
    max_gap_s: Annotated[float, Field(gt=0)] = 0.3
    engine: Literal["compiled", "filterpy"] = "compiled"
    noise: NoiseTable = NoiseTable()


class ReportTable(Settings):
    """The report."""

    restart_s: Annotated[float, Field(gt=0)] = 2.0
    timing_repeats: Annotated[int, Field(ge=0)] = 21  # 0: not timed; equal runs on one machine have equal reports
    losses: list[CarLoss] = Field(default_factory=list)  # that are compared, beside the comparison of models


_FIELDS: dict[str, Any] = {
    name.replace("-", "_"): (row.settings, Field(default_factory=row.settings, alias=name))
    for name, row in FITTED.items()
}
FitTables = create_model("FitTables", __base__=Settings, **_FIELDS)
"""One table of settings for each model, `[fit.NAME]`."""


def _known_model(name: str) -> str:
    if name not in FITTED:
        raise ValueError(f"there is no model {name!r} to fit; choose from {', '.join(FITTED)}")
    return name


LoosePath = Annotated[Path, Field(strict=False)]


class PlanFile(Settings):
    """A pipeline file as it stands; paths count from the file's folder."""

    vehicle: LoosePath
    training: Annotated[list[LoosePath], Field(min_length=1)]
    validation: LoosePath | None = None
    truth: LoosePath | None = None  # folder of NAME.parquet, simulated takes only
    workspace: LoosePath = Path("workspace")
    seed: int = 1
    models: list[Annotated[str, AfterValidator(_known_model)]] = Field(default_factory=lambda: list(FITTED))
    estimate: EstimateTable = EstimateTable()
    diagnose: list[LoosePath] = Field(default_factory=list)  # recordings; empty: those named above
    fit: FitTables = Field(default_factory=FitTables)
    report: ReportTable = ReportTable()


class Plan(Settings):
    """A checked plan with paths as they are to be opened."""

    source: str
    vehicle: Path
    training: tuple[Path, ...]
    validation: Path | None
    truth: Path | None
    workspace: Path
    seed: int
    models: tuple[str, ...]
    estimate: EstimateTable
    fit: dict[str, dict[str, Any]]  # settings by model
    report: ReportTable
    diagnose: tuple[Path, ...] = ()
    commands: Path | None = None  # of a single recording named on the command line
    allow_partial: bool = False  # recordings of which a part cannot be read are used without it

    def with_loss(self, loss: CarLoss) -> Plan:
        """The same plan with every model that can be fitted so fitted by `loss`."""
        changed = {n: {"loss": loss} if loss in row.losses else {} for n, row in FITTED.items()}
        return self.model_copy(update={"fit": {n: self.fit_settings(n) | more for n, more in changed.items()}})

    def fit_settings(self, model: str) -> dict[str, Any]:
        """The pipeline file's settings of a model, or its defaults."""
        return self.fit.get(model) or FITTED[model].defaults


def read_plan(path: Path) -> Plan:
    """The plan in the pipeline file at `path`.

    Raises:
        InputRefused: with every problem in it.
    """
    if not path.exists():
        raise InputRefused(
            path, "pipeline file", "there is none here", "write one with `bcid init`, or name one with -p"
        )
    file = read_toml(path, PlanFile, "pipeline file")
    here = path.parent

    def at(p: Path | None) -> Path | None:
        return None if p is None else Path(*_normal(here / p))

    return Plan(
        source=str(path), vehicle=at(file.vehicle) or here, training=tuple(at(p) or here for p in file.training),
        validation=at(file.validation), truth=at(file.truth), workspace=at(file.workspace) or here,
        seed=file.seed, models=tuple(file.models), estimate=file.estimate, report=file.report,
        diagnose=tuple(at(p) or here for p in file.diagnose),
        fit=file.fit.model_dump(mode="json", by_alias=True),
    )  # fmt: skip


def _normal(path: Path) -> list[str]:
    """The path's parts without `x/..`."""
    parts: list[str] = []
    for part in path.parts:
        if part == ".." and parts and parts[-1] not in ("..", "/"):
            parts.pop()
        else:
            parts.append(part)
    return parts

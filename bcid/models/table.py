"""The models by name.  A row's module is imported only when the model is used."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

from bcid.errors import UsageError
from bcid.files.toml import Settings
from bcid.models.interface import Model
from bcid.models.settings import (
    NewtonEulerSettings,
    NoSettings,
    ResidualTrainingSettings,
    SparseSettings,
    TrainingSettings,
)


@dataclass(frozen=True)
class TableRow:
    """One model: where it is, what it is derived from, what its fit may be told."""

    module: str
    kind: str
    settings: type[Settings]  # of [fit.NAME] in the pipeline file
    summary: str
    base: str | None = None  # the model whose fit it starts from
    base_settings: Mapping[str, Any] = field(default_factory=dict)  # with which, whatever the plan says of it
    made_by: str | None = None  # the command that makes it, where that is not `bcid fit`

    def load(self) -> type[Model]:
        """The model's class."""
        kind: type[Model] = getattr(importlib.import_module(self.module), self.kind)
        return kind

    @property
    def losses(self) -> tuple[str, ...]:
        """What its fit can minimise, where there is a choice."""
        choice = self.settings.model_fields.get("loss")
        return get_args(choice.annotation) if choice else ()

    @property
    def defaults(self) -> dict[str, Any]:
        """The settings' defaults."""
        return self.settings().model_dump(mode="json")


MODELS: dict[str, TableRow] = {
    "newton-euler": TableRow(
        "bcid.models.newton_euler.model", "NewtonEuler", NewtonEulerSettings,
        "rigid body, motor, drag and saturating tyres",
    ),
    "newton-euler-linear": TableRow(
        "bcid.models.newton_euler.linear", "NewtonEulerLinear", NoSettings,
        "its linearisation about straight driving", base="newton-euler",
    ),
    "narx-mlp": TableRow(
        "bcid.models.network.narx_mlp", "NarxMlp", TrainingSettings,
        "the next twist from the last three twists and commands"
    ),
    "k-mlp": TableRow(
        "bcid.models.kinematic.k_mlp", "KMlp", TrainingSettings, "the kinematic state's evolution as a perceptron"
    ),
    "k-sindy": TableRow(
        "bcid.models.kinematic.k_sindy", "KSindy", SparseSettings, "the kinematic state's evolution as a sparse sum"
    ),
    "k-sindy-mlp": TableRow(
        "bcid.models.kinematic.k_sindy_mlp", "KSindyMlp", ResidualTrainingSettings,
        "the sparse sum and a smaller perceptron on its residual", base="k-sindy",
        base_settings={"loss": "one-step"},  # its rollouts alone leave a residual that is harder to learn
    ),
    "newton-euler-augmented": TableRow(
        "bcid.models.newton_euler.augmented", "AugmentedNewtonEuler", NoSettings,
        "the Newton-Euler car with effects of the vocabulary", made_by="bcid diagnose",
    ),
}  # fmt: skip

FITTED: dict[str, TableRow] = {name: row for name, row in MODELS.items() if row.made_by is None}
"""Those that `bcid fit` makes."""


def row_of(name: str) -> TableRow:
    """The table's row of a model.

    Raises:
        UsageError: an unknown name, with the known ones.
    """
    if name not in MODELS:
        raise UsageError(f"there is no model {name!r}\n  next: choose one of {', '.join(MODELS)}")
    return MODELS[name]


def row_to_fit(name: str) -> TableRow:
    """The table's row of a model that can be fitted.

    Raises:
        UsageError: an unknown name, or a model that is made otherwise.
    """
    row = row_of(name)
    if row.made_by is not None:
        raise UsageError(f"{name} is made by `{row.made_by}`\n  next: fit one of {', '.join(FITTED)}")
    return row

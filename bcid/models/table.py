"""The models by name.  A row's module is imported only when the model is used."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from bcid.errors import UsageError
from bcid.models.interface import Model


@dataclass(frozen=True)
class TableRow:
    """One model: where it is, what it is derived from, what its fit may be told."""

    module: str
    kind: str
    summary: str
    base: str | None = None  # the model whose fit it starts from
    defaults: Mapping[str, Any] = field(default_factory=dict)  # of [fit.NAME] in the pipeline file

    def load(self) -> type[Model]:
        """The model's class."""
        kind: type[Model] = getattr(importlib.import_module(self.module), self.kind)
        return kind


_TRAINING: dict[str, Any] = {
    "hidden": [256, 128], "epochs": 200, "batch_size": 256, "learning_rate": 5e-5, "weight_decay": 1e-5,
    "decay_factor": 0.6, "decay_epochs": 40, "dropout": 0.02,
}  # fmt: skip

MODELS: dict[str, TableRow] = {
    "newton-euler": TableRow(
        "bcid.models.newton_euler", "NewtonEuler", "rigid body, motor, drag and saturating tyres; genetic algorithm",
        defaults={"population": 150, "generations": 100, "v_0_mps": 1.0},
    ),
    "newton-euler-linear": TableRow(
        "bcid.models.newton_euler_linear", "NewtonEulerLinear", "its linearisation about straight driving",
        base="newton-euler",
    ),
    "narx-mlp": TableRow(
        "bcid.models.narx_mlp", "NarxMlp", "the next twist from the last three twists and commands", defaults=_TRAINING
    ),
    "k-mlp": TableRow(
        "bcid.models.k_mlp", "KMlp", "the kinematic state's evolution as a perceptron", defaults=_TRAINING
    ),
    "k-sindy": TableRow(
        "bcid.models.k_sindy", "KSindy", "the kinematic state's evolution as a sparse sum",
        defaults={"threshold": 0.02, "ridge": 1e-6, "library": "dissipative"},
    ),
    "k-sindy-mlp": TableRow(
        "bcid.models.k_sindy_mlp", "KSindyMlp", "the sparse sum and a smaller perceptron on its residual",
        base="k-sindy", defaults=_TRAINING | {"hidden": [128, 64]},
    ),
}  # fmt: skip


def row_of(name: str) -> TableRow:
    """The table's row of a model.

    Raises:
        UsageError: an unknown name, with the known ones.
    """
    if name not in MODELS:
        raise UsageError(f"there is no model {name!r}\n  next: choose one of {', '.join(MODELS)}")
    return MODELS[name]

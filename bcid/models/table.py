"""The models by name.  The module of a row is imported only when the model is used."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, get_args

from bcid.errors import UsageError
from bcid.files.toml import Settings
from bcid.libraries import require_library
from bcid.models.settings import NewtonEulerSettings, ResidualSettings, SparseSettings, TrainingSettings

if TYPE_CHECKING:
    from bcid.models.interface import Model


@dataclass(frozen=True)
class ModelRow:
    """One model: where it is defined, what it is derived from, which settings its fit takes."""

    module: str
    class_name: str
    settings: type[Settings]  # of [fit.NAME] in the pipeline file; the base class where there are none
    summary: str
    base: str | None = None  # the model whose fit it starts from
    base_settings: Mapping[str, Any] = field(default_factory=dict)  # of that fit, whatever the pipeline file says
    made_by: str | None = None  # the command that makes it, where that is not `bcid fit`
    trained_by: str | None = None  # the library that only its fit needs; saved, it is driven without

    def load_class(self) -> type[Model]:
        """Import and return the model's class."""
        model_class: type[Model] = getattr(importlib.import_module(self.module), self.class_name)
        return model_class

    @property
    def losses(self) -> tuple[str, ...]:
        """The losses that the fit can minimise; empty where there is no choice."""
        choice = self.settings.model_fields.get("loss")
        return get_args(choice.annotation) if choice else ()

    @property
    def defaults(self) -> dict[str, Any]:
        """The default settings of the fit."""
        return self.settings().model_dump(mode="json")


MODELS: dict[str, ModelRow] = {
    "newton-euler": ModelRow(
        "bcid.models.newton_euler.model", "NewtonEuler", NewtonEulerSettings,
        "rigid body, motor, drag and saturating tyres",
    ),
    "newton-euler-linear": ModelRow(
        "bcid.models.newton_euler.linear", "NewtonEulerLinear", Settings,
        "its linearisation about straight driving", base="newton-euler",
    ),
    "narx-mlp": ModelRow(
        "bcid.models.network.narx_mlp", "NarxMlp", TrainingSettings,
        "the next twist from the last three twists and commands", trained_by="torch",
    ),
    "k-mlp": ModelRow(
        "bcid.models.kinematic.k_mlp", "KMlp", TrainingSettings, "the kinematic state's evolution as a perceptron",
        trained_by="torch",
    ),
    "k-sindy": ModelRow(
        "bcid.models.kinematic.k_sindy", "KSindy", SparseSettings, "the kinematic state's evolution as a sparse sum"
    ),
    "k-sindy-mlp": ModelRow(
        "bcid.models.kinematic.k_sindy_mlp", "KSindyMlp", ResidualSettings,
        "the sparse sum and a smaller perceptron on its residual", base="k-sindy",
        # Fitted on its own rollouts, it leaves a residual that is harder to learn.
        base_settings={"loss": "one-step"}, trained_by="torch",
    ),
    "newton-euler-augmented": ModelRow(
        "bcid.models.newton_euler.augmented", "AugmentedNewtonEuler", Settings,
        "the Newton-Euler car with effects of the vocabulary", made_by="bcid diagnose",
    ),
    "newton-euler-remainder": ModelRow(
        "bcid.models.newton_euler.with_remainder", "NewtonEulerWithRemainder", Settings,
        "that car and free functions of its state, which act where it was driven", made_by="bcid diagnose",
    ),
}  # fmt: skip

FITTABLE: dict[str, ModelRow] = {name: row for name, row in MODELS.items() if row.made_by is None}
"""The rows of the models that `bcid fit` makes."""


def model_row(name: str) -> ModelRow:
    """The row of `MODELS` (class, settings, base model) with the given model `name`, such as "k-sindy".

    Raises:
        UsageError: there is no such model; the message lists the known ones.
    """
    if name not in MODELS:
        raise UsageError(f"there is no model {name!r}\n  next: choose one of {', '.join(MODELS)}")
    return MODELS[name]


def fittable_row(name: str) -> ModelRow:
    """The row of `MODELS` (class, settings, base model) with the given `name`, if `bcid fit` makes that model.

    Raises:
        UsageError: there is no such model, or another command makes it.
    """
    row = model_row(name)
    if row.made_by is not None:
        raise UsageError(f"{name} is made by `{row.made_by}`\n  next: fit one of {', '.join(FITTABLE)}")
    return row


def require_training_libraries(names: Iterable[str]) -> None:
    """Do nothing where the models `names` can be trained with the libraries that are installed.

    Raises:
        LibraryMissing: one of them needs a library that is not.
    """
    for name in names:
        library = model_row(name).trained_by
        if library is not None:
            require_library(library, f"training {name}")

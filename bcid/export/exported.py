"""What is exported: a model's formulas, the name of its files, and the drive by which they are checked."""

from __future__ import annotations

import re
from dataclasses import dataclass

from bcid import __version__
from bcid.errors import UsageError
from bcid.evaluation.validity import ModelValidity
from bcid.export.augmented_formulas import leave_out_measurement, trace_augmented
from bcid.export.formulas import StepFormulas
from bcid.export.model_formulas import TRACED
from bcid.export.reference_drive import ReferenceDrive, drive_for_reference
from bcid.models.interface import Model
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler

NAME = re.compile(r"[a-z][a-z0-9_]{0,62}")
"""What can be a name in all languages, and of files."""


@dataclass(frozen=True)
class Exported:
    """One model as it is exported."""

    name: str
    model: Model
    digest: str
    formulas: StepFormulas
    vectors: ReferenceDrive
    validity: ModelValidity | None
    time_s: float | None
    without_measurement: bool

    @property
    def about(self) -> str:
        """A sentence that stands at the head of every file."""
        return (
            f"{self.name}: one period of {self.formulas.period_s:g} s of a {self.model.name} model, "
            f"by bcid {__version__} from the model {self.digest[:12]}"
        )


def export_model(
    model: Model,
    digest: str,
    validity: ModelValidity | None,
    name: str | None = None,
    of_vehicle: bool = False,
    time_s: float | None = None,
) -> Exported:
    """A saved `model` made ready for export, as files called `name`; by default as the model is called.

    `of_vehicle` leaves out the effects of how poses were measured; at `time_s` (s) of the recording stand the effects
    that depend on its time, which otherwise go on.

    Raises:
        UsageError: the name is none, or the model has a clock that drifts and no time is given.
        InputRefused: the model leaves the finite numbers when it is driven for a check.
    """
    name = name or model.name.replace("-", "_")
    if not NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} cannot be a name in C, Python and of files\n"
            "  next: use small letters, digits and _, a letter first"
        )
    if isinstance(model, AugmentedNewtonEuler):
        model = leave_out_measurement(model) if of_vehicle else model
        formulas = trace_augmented(model, time_s)
    else:
        formulas = TRACED[model.name](model)
    vectors = drive_for_reference(model, formulas, validity and validity.range, time_s)
    return Exported(name, model, digest, formulas, vectors, validity, time_s, of_vehicle)

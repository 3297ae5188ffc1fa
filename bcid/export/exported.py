"""What is exported: a model's formulas, the name of its files, and the drive by which they are checked."""

from __future__ import annotations

from dataclasses import dataclass

from bcid import __version__
from bcid.errors import UsageError
from bcid.evaluation.validity import ModelValidity
from bcid.export.augmented_formulas import drifts, has_time, leave_out_measurement, trace_augmented
from bcid.export.commands import commands_of
from bcid.export.formulas import CENTRE_OF_GRAVITY, TWIST, StepFormulas, Variable
from bcid.export.model_formulas import TRACED
from bcid.export.names import check_name
from bcid.export.reference_drive import ReferenceDrive, drive_for_reference
from bcid.models.interface import Model
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder


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
    measured_otherwise: bool  # whether what was recorded is not the motion of the centre of gravity, as far as is known

    @property
    def point(self) -> str:
        """The point of the vehicle whose poses and twists it takes and gives."""
        return CENTRE_OF_GRAVITY if self.without_measurement else "tracked point"

    @property
    def commands(self) -> tuple[Variable, ...]:
        """The commands with what they mean to this model."""
        return commands_of(self.model)

    @property
    def twist(self) -> tuple[Variable, ...]:
        """The twist, of which point it is being said."""
        return tuple(q._replace(meaning=f"{q.meaning}, of the {self.point}") for q in TWIST)

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
        UsageError: nothing can be called `name`; the model has functions without a name; `of_vehicle` or `time_s` would
            change nothing; or the model has a clock that drifts and no time is given.
        InputRefused: the model leaves the finite numbers when it is driven for a check.
    """
    name = check_name(model.name.replace("-", "_") if name is None else name)
    if isinstance(model, NewtonEulerWithRemainder):
        raise UsageError(
            f"{model.name} has functions without a name, which no export writes\n"
            "  next: export the diagnosed car with names alone, in the folder `model` beside it"
        )
    vehicle = leave_out_measurement(model) if isinstance(model, AugmentedNewtonEuler) else model
    measured_otherwise = vehicle is not model and vehicle != model
    if of_vehicle and not measured_otherwise:
        raise UsageError(
            f"{model.name} has no effects of how poses were measured, which --as vehicle would leave out\n"
            "  next: leave out --as"
        )
    model = vehicle if of_vehicle else model
    formulas = _trace_at(model, time_s)
    vectors = drive_for_reference(model, formulas, validity and validity.range, time_s)
    return Exported(name, model, digest, formulas, vectors, validity, time_s, of_vehicle, measured_otherwise)


def _trace_at(model: Model, time_s: float | None) -> StepFormulas:
    """The formulas of `model`, effects of the recording's time standing at `time_s` (s) where that is given.

    Raises:
        UsageError: there are none of these, or a clock drifts and no time is given.
    """
    if isinstance(model, AugmentedNewtonEuler):
        formulas = trace_augmented(model, time_s)
        is_timed = time_s is not None and (drifts(model) or has_time(trace_augmented(model)))
    else:
        formulas = TRACED[model.name](model)
        is_timed = False
    if time_s is not None and not is_timed:
        raise UsageError(
            f"nothing in {model.name} depends on the time of the recording, at which --time would hold it\n"
            "  next: leave out --time"
        )
    return formulas

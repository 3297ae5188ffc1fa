"""What a run says of its cars.  A run is a workspace, the folder of a diagnosis, or a saved model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from bcid.documents.diagnosis import DiagnosisDocument, NamedEffect, Quantity
from bcid.errors import InputRefused
from bcid.evaluation.parameter_differences import KnownConstant
from bcid.evaluation.residuals import load_residuals
from bcid.evaluation.seen_takes import TakeSteps, load_seen_takes
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import (
    constant_units,
    stated_errors,
    values_of_constants,
)
from bcid.models.saving import load_model
from bcid.pipeline.named_models import DIAGNOSED, MODEL_FILES, find_model, saved_models
from bcid.report.formats import plain_name

DOCUMENT = "diagnosis.json"


class ComparableModel(NamedTuple):
    """What a run says of one model: its constants with their errors, what it found, and how far to believe that."""

    name: str
    constants: dict[str, KnownConstant]
    diagnosis: DiagnosisDocument | None
    takes: Sequence[TakeSteps]  # that it was made from; none where nobody knows
    residual_multiple: float | None  # of a model's that lacks nothing, where physics is missing
    fit: NewtonEuler | None = None  # whose constants these are; of a diagnosis and of a car with effects none

    @property
    def findings(self) -> dict[str, NamedEffect]:
        """What was named, by effect."""
        return {f.effect: f for f in self.diagnosis.findings} if self.diagnosis else {}

    def why_silent(self, effect: NamedEffect) -> str:
        """Why this run need not have named an effect though the car has it, in words; empty where it would have."""
        if self.diagnosis is None:
            return "the other run was not diagnosed"
        if too_small := self._why_too_small(effect):
            return too_small
        alike = [n for n, other in self.findings.items() if n in effect.twins or effect.effect in other.twins]
        if alike:
            return f"the other run names {plain_name(alike[0])}, which looks the same"
        return f"in the other run {self.unresolved_causes}, which may be it" if self.unresolved_causes else ""

    def _why_too_small(self, effect: NamedEffect) -> str:
        """That the takes of this run show an effect only at a larger size, in words; empty where they would show it."""
        for unseen in self.diagnosis.not_excited if self.diagnosis else ():
            if unseen.effect != effect.effect:
                continue
            smallest = unseen.smallest_detectable.value if unseen.smallest_detectable else None
            size = effect.parameters.get(unseen.parameter, Quantity()).value
            if smallest is None or size is None:
                return "the takes of the other run would not have shown it"
            if abs(size) < abs(smallest):
                least = f"{smallest:.2g} {unseen.smallest_detectable.unit if unseen.smallest_detectable else ''}"
                return f"the takes of the other run would show {least.rstrip()} or more, and this is {abs(size):.2g}"
        return ""

    @property
    def unresolved_causes(self) -> str:
        """What a diagnosis leaves open, in words; empty where it was not made, or is sure of all that it says."""
        if self.diagnosis is None:
            return ""
        if self.diagnosis.verdict == "ambiguous":
            return "several causes explain the takes equally well"
        if self.diagnosis.verdict == "unknown" or self.diagnosis.unknown is not None:
            return "something is left without a name"
        return ""


def read_run(named: str, workspace: Callable[[], Path | None]) -> list[ComparableModel]:
    """The models of a run that state errors of their constants, a diagnosis first.

    Raises:
        InputRefused: nothing of that name is a run, or it holds no such model.
    """
    path = Path(named)
    if (path / DOCUMENT).is_file():
        return [_from_diagnosis(path)]
    if (path / MODEL_FILES[0]).is_file() or not path.is_dir():
        folder = find_model(named, workspace)
        made_beside = folder.name == "model" and (folder.parent / DOCUMENT).is_file()
        found = [_from_diagnosis(folder.parent) if made_beside else _from_model(Path(named).name, folder)]
    else:
        home = path / DIAGNOSED
        found = [_from_diagnosis(home)] if (home / DOCUMENT).is_file() else []
        found += [_from_model(name, folder) for name, folder in saved_models(path).items() if name != DIAGNOSED]
    known = [model for model in found if model is not None and (model.constants or model.diagnosis)]
    if not known:
        cause = "holds neither a diagnosis nor a car whose constants have stated errors"
        raise InputRefused(
            named, "run", cause, "name a workspace in which `bcid fit -m newton-euler` or `diagnose` ran"
        )
    return known


def _from_model(name: str, folder: Path) -> ComparableModel | None:
    """What a saved model states; None where it is no car of which errors are stated."""
    model = load_model(folder)
    if isinstance(model, NewtonEuler):
        constants = _constants_of_fit(model)
    elif isinstance(model, AugmentedNewtonEuler):
        constants = _constants_of_augmented(model)
    else:
        return None
    residuals = load_residuals(folder)
    multiple = residuals.multiple if residuals and residuals.show_missing_physics else None
    fit = model if isinstance(model, NewtonEuler) else None
    return ComparableModel(name, constants, None, load_seen_takes(folder) or (), multiple, fit)


def _constants_of_fit(model: NewtonEuler) -> dict[str, KnownConstant]:
    """The constants of a fitted car that its takes identify."""
    facts = model.facts
    values, errors = values_of_constants(model.car, facts), stated_errors(model.car, facts)
    return {
        symbol: KnownConstant(values[symbol], error, about["unit"])
        for symbol, about in facts.get("fitted", {}).items()
        if (error := errors[symbol]) is not None
    }


def _constants_of_augmented(model: AugmentedNewtonEuler) -> dict[str, KnownConstant]:
    """The constants of a car with effects whose errors are stated, without the effects' own parameters."""
    units = constant_units(model.car)
    errors = {symbol: model.facts.get("se", {}).get(symbol) for symbol in model.facts.get("fitted", ())}
    return {
        symbol: KnownConstant(getattr(model.car, symbol), float(se), units.get(symbol, ""))
        for symbol, se in errors.items()
        if se is not None and se > 0.0 and hasattr(model.car, symbol)
    }


def _from_diagnosis(folder: Path) -> ComparableModel:
    """What a diagnosis states: the refitted base constants, and the parameters of what it named."""
    document = DiagnosisDocument.read(folder / DOCUMENT)
    shown = {p.symbol: p for p in document.base.parameters if p.shown and not p.at_bound}
    named = {f"{f.effect} {s}": q for f in document.findings for s, q in f.parameters.items() if not q.at_bound}
    constants = {
        symbol: KnownConstant(q.value, q.se, q.unit)
        for symbol, q in (shown | named).items()
        if q.value is not None and q.se is not None and q.se > 0.0
    }
    takes = load_seen_takes(folder / "model") or ()
    return ComparableModel(DIAGNOSED, constants, document, takes, None)

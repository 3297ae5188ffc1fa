"""Two runs side by side: is it the same car?  A run is a workspace, the folder of a diagnosis, or a saved model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from bcid.documents.comparison import ComparisonDocument, ConstantChange, LoneFinding, ModelComparison
from bcid.documents.diagnosis import DiagnosisDocument, NamedEffect, Quantity
from bcid.errors import InputRefused, UsageError
from bcid.evaluation.parameter_differences import (
    ConstantDifference,
    KnownConstant,
    chance_of_differences,
    list_differences,
    z_beyond_chance,
)
from bcid.evaluation.residuals import load_residuals
from bcid.evaluation.seen_takes import TakeSteps, is_same_drive, load_seen_takes
from bcid.models.limits import LIMITS
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import (
    BIASED_TWISTS,
    constant_units,
    drag_per_speed,
    errors_lack_bias,
    is_identified,
    values_of_constants,
)
from bcid.models.saving import load_model
from bcid.pipeline.named_models import DIAGNOSED, MODEL_FILES, find_model, saved_models

DOCUMENT = "diagnosis.json"
PLACES = {"one": "first", "other": "second"}


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
            return "it was not diagnosed"
        if effect.effect in {unseen.effect for unseen in self.diagnosis.not_excited}:
            return "its takes would not have shown it"
        alike = [n for n, other in self.findings.items() if n in effect.twins or effect.effect in other.twins]
        if alike:
            return f"it names {alike[0]}, which looks the same"
        return f"{self.open_end}, which may be it" if self.open_end else ""

    @property
    def open_end(self) -> str:
        """What a diagnosis leaves open, in words; empty where it was not made, or is sure of all that it says."""
        if self.diagnosis is None:
            return ""
        if self.diagnosis.verdict == "ambiguous":
            return "several causes explain its takes equally well"
        if self.diagnosis.verdict == "unknown" or self.diagnosis.unknown is not None:
            return "it leaves something without a name"
        return ""


def compare_runs(one: str, other: str, workspace: Callable[[], Path | None]) -> ComparisonDocument:
    """Compare two runs, each named by a path or by the name of a saved model in `workspace()`.

    Of two workspaces the diagnoses and all cars of the same name are compared; a single model is compared with a
    single one, whatever they are called.

    Raises:
        InputRefused: one is no run, or cannot be read.
        UsageError: the two have nothing in common that could be compared.
    """
    runs = [read_run(named, workspace) for named in (one, other)]
    if all(len(run) == 1 for run in runs):
        pairs = [(runs[0][0], runs[1][0])]
    else:
        others = {model.name: model for model in runs[1]}
        pairs = [(model, others[model.name]) for model in runs[0] if model.name in others]
    if not pairs:
        names = [", ".join(m.name for m in run) for run in runs]
        raise UsageError(
            f"{one} holds {names[0]}, and {other} {names[1]}: no model of one name\n"
            "  next: name two models, such as WORKSPACE/models/newton-euler"
        )
    return ComparisonDocument(one=one, other=other, models=tuple(compare_models(a, b) for a, b in pairs))


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
    values = values_of_constants(model.car, facts)
    return {
        symbol: KnownConstant(values[symbol], about["relative_se"] * abs(values[symbol]), about["unit"])
        for symbol, about in facts.get("fitted", {}).items()
        if is_identified(symbol, facts)
    }


def _at_one_speed(one: ComparableModel, other: ComparableModel) -> tuple[ComparableModel, ComparableModel, list[str]]:
    """Two models whose drag per speed, R_v, is that at the lower of their top speeds, and notes that say so.

    R_v = R_1 + R_2 v is fitted at each take's own top speed, so that those of one car differ by R_2 times the
    difference of these speeds.  Where the errors at another speed are not known, R_v is left out of both.
    """
    fits = [model.fit for model in (one, other)]
    if not all("R_v" in model.constants for model in (one, other)) or None in fits:
        return one, other, []
    speeds = [float(fit.facts.get("top_speed_mps", 0.0)) for fit in fits if fit]
    if speeds[0] == speeds[1]:
        return one, other, []
    drags = [_drag_at_speed(fit, min(speeds)) if min(speeds) > 0.0 else None for fit in fits if fit]
    known = [drag for drag in drags if drag is not None]
    fitted_at = f"R_v was fitted at {speeds[0]:.2f} and at {speeds[1]:.2f} m/s"
    if len(known) < len(drags):
        without = [{s: c for s, c in model.constants.items() if s != "R_v"} for model in (one, other)]
        note = f"{fitted_at}, and is not compared: the fits do not say how sure it is at another speed"
        return one._replace(constants=without[0]), other._replace(constants=without[1]), [note]
    both = [m.constants | {"R_v": drag} for m, drag in zip((one, other), known, strict=True)]
    note = f"{fitted_at}, and is compared at {min(speeds):.2f} m/s"
    return one._replace(constants=both[0]), other._replace(constants=both[1]), [note]


def _drag_at_speed(model: NewtonEuler, speed: float) -> KnownConstant | None:
    """The drag over speed R_v of a fitted car at a `speed` (m/s) of at most its take's top speed V, with its error.

    With a = speed / V it is (1 - a) R_1 + a R_v(V).  A correlation that the fit does not state is at most
    LIMITS.min_correlation, for which the error is the largest.  None where the take does not show R_1.
    """
    facts, values = model.facts, values_of_constants(model.car, model.facts)
    about, a = facts["fitted"], speed / float(facts["top_speed_mps"])
    se = {s: about[s]["relative_se"] * abs(values[s]) for s in ("R_1", "R_v") if about.get(s, {}).get("relative_se")}
    if a == 1.0:
        return KnownConstant(values["R_v"], se["R_v"], about["R_v"]["unit"])
    if "R_1" not in se or "R_1" in facts.get("at_bound", ()):
        return None
    stated = {frozenset(pair): rho for *pair, rho in facts.get("correlated", ())}
    rho = stated.get(frozenset(("R_1", "R_v")), LIMITS.min_correlation)
    low, high = (1.0 - a) * se["R_1"], a * se["R_v"]
    error = math.sqrt(low**2 + high**2 + 2.0 * rho * low * high)
    return KnownConstant(drag_per_speed(model.car, speed), error, about["R_v"]["unit"])


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


def compare_models(one: ComparableModel, other: ComparableModel) -> ModelComparison:
    """The differences between two models' constants and findings, with a verdict in words."""
    one, other, notes = _at_one_speed(one, other)
    differences = list_differences(one.constants, other.constants)
    needed = z_beyond_chance(len(differences))
    lone = _lone_findings(one, other)
    differing = [d for d in differences if abs(d.z) > needed]
    cautions = _cautions(one, other)
    verdict, sentence = _judge(differences, differing, lone, bool(cautions))
    return ModelComparison(
        one=one.name, other=other.name, verdict=verdict, sentence=sentence, z_needed=needed,
        chance=chance_of_differences(differences) if differences else None,
        constants=tuple(_describe_difference(d, needed) for d in differences),
        only_one=tuple(s for s in one.constants if s not in other.constants),
        only_other=tuple(s for s in other.constants if s not in one.constants),
        lone_findings=lone, cautions=tuple(cautions), notes=tuple(notes),
    )  # fmt: skip


def _describe_difference(difference: ConstantDifference, needed: float) -> ConstantChange:
    """A difference as the document holds it."""
    one, other = (Quantity(value=c.value, se=c.se, unit=c.unit) for c in (difference.one, difference.other))
    return ConstantChange(
        symbol=difference.symbol, one=one, other=other, change=difference.change, change_se=difference.change_se,
        share=difference.share, z=difference.z, differs=abs(difference.z) > needed,
        least_visible=needed * difference.change_se,
    )  # fmt: skip


def _lone_findings(one: ComparableModel, other: ComparableModel) -> tuple[LoneFinding, ...]:
    """Effects that only one of two diagnoses names; none where either run was not diagnosed."""
    if one.diagnosis is None or other.diagnosis is None:
        return ()
    sides = (("one", one, other), ("other", other, one))
    return tuple(
        LoneFinding(effect=name, found_in=side, sentence=effect.sentence, decides=not why, why_not=why)
        for side, found, without in sides
        for name, effect in found.findings.items()
        if name not in without.findings
        for why in (without.why_silent(effect),)
    )


def _judge(
    differences: Sequence[ConstantDifference],
    differing: Sequence[ConstantDifference],
    lone: Sequence[LoneFinding],
    errors_are_doubtful: bool,
) -> tuple[Literal["same", "different", "undecided"], str]:
    """The verdict on two models, and a sentence that gives its reasons, the most certain first.

    Constants that differ by more than their errors prove nothing where these errors are doubtful, and neither does an
    effect that the other run need not have named.
    """
    changes = [describe_change(d) for d in sorted(differing, key=lambda d: -abs(d.z))]
    found = [f"{f.effect} is found in the {PLACES[f.found_in]} only" for f in lone if f.decides]
    silent = [
        f"{f.effect} is found in the {PLACES[f.found_in]} only; of the other, {f.why_not}"
        for f in lone
        if not f.decides
    ]
    if found or (changes and not errors_are_doubtful):
        return "different", f"Not the same: {'; '.join([*found, *changes])}."
    if changes:
        return "undecided", f"Undecided: {'; '.join(changes)}; but the ± of these runs are not to be relied upon."
    if not differences and not silent:
        return "undecided", "Undecided: no constant is identified in both."
    if silent:
        agree = f", while none of {len(differences)} constants differs by more than chance" if differences else ""
        return "undecided", f"Undecided: {'; '.join(silent)}{agree}."
    most = describe_change(max(differences, key=lambda d: abs(d.z)))
    count = (
        f"none of {len(differences)} constants differs" if len(differences) > 1 else "the one constant does not differ"
    )
    sentence = f"The same within what the takes can tell: {count} by more than chance (the most: {most})."
    return "same", sentence


def describe_change(difference: ConstantDifference) -> str:
    """A change in words: "C_f fell by 12 % (4.1 σ)"."""
    way = "rose" if difference.change > 0.0 else "fell"
    share, change = difference.share, f"{abs(difference.change):.2g} {difference.one.unit}".rstrip()
    size = change if share is None else f"{100.0 * abs(share):.2g} %"
    return f"{difference.symbol} {way} by {size} ({abs(difference.z):.1f} σ)"


def _cautions(one: ComparableModel, other: ComparableModel) -> list[str]:
    """Why a verdict on two models may be worth less than it says."""
    cautions = []
    shared = sorted({a.name for a in one.takes for b in other.takes if is_same_drive(a, b)})
    if shared:
        cautions.append(
            f"both were made from {', '.join(shared)}: their errors are not independent, and σ is not what it seems"
        )
    sides = list(zip(PLACES.values(), (one, other), strict=True))
    lacking = {place: m.residual_multiple for place, m in sides if m.residual_multiple is not None}
    if lacking:
        cautions.append(
            f"physics is missing from the {' and the '.join(lacking)}, whose residuals are "
            f"{' and '.join(f'{v:.1f}' for v in lacking.values())} times those of a model that lacks nothing: the ± "
            "are too small; compare diagnoses, which name what is missing"
        )
    biased = [place for place, m in sides if m.fit and errors_lack_bias(m.fit.facts)]
    if biased:
        cautions.append(f"the {' and the '.join(biased)}: {BIASED_TWISTS}")
    for place, model in sides:
        if model.open_end:
            cautions.append(f"of the {place} diagnosis, {model.open_end}: its ± may be too small")
    return cautions

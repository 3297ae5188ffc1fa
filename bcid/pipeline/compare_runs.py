"""Two runs side by side: is it the same car?  The differences, the verdict, and what it may be worth less for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from bcid.documents.comparison import ComparisonDocument, ConstantChange, LoneFinding, ModelComparison
from bcid.documents.diagnosis import NamedEffect, Quantity
from bcid.errors import UsageError
from bcid.evaluation.drag_at_one_speed import drag_at_lower_speed
from bcid.evaluation.parameter_differences import (
    ConstantDifference,
    chance_of_differences,
    list_differences,
    z_beyond_chance,
)
from bcid.evaluation.seen_takes import is_same_drive
from bcid.models.newton_euler.parameters import BIASED_TWISTS, errors_lack_bias
from bcid.pipeline.read_run import ComparableModel, read_run
from bcid.report.formats import plain_name

PLACES = {"one": "first", "other": "second"}


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


def _at_one_speed(one: ComparableModel, other: ComparableModel) -> tuple[ComparableModel, ComparableModel, list[str]]:
    """Two models whose drag per speed, R_v, is that at one speed, or left out of both, and notes that say so."""
    if one.fit is None or other.fit is None or not all("R_v" in model.constants for model in (one, other)):
        return one, other, []
    drags, note = drag_at_lower_speed(one.fit, other.fit)
    if drags is None:
        one, other = (m._replace(constants={s: c for s, c in m.constants.items() if s != "R_v"}) for m in (one, other))
    else:
        one, other = (
            m._replace(constants=m.constants | {"R_v": drag}) for m, drag in zip((one, other), drags, strict=True)
        )
    return one, other, [note] if note else []


def compare_models(one: ComparableModel, other: ComparableModel) -> ModelComparison:
    """The differences between two models' constants and findings, with a verdict in words."""
    one, other, notes = _at_one_speed(one, other)
    differences, cautions = list_differences(one.constants, other.constants), _cautions(one, other)
    # an effect that only one run names is one more comparison, of its size with none
    needed = z_beyond_chance(len(differences) + len(set(one.findings) ^ set(other.findings)))
    lone = _lone_findings(one, other, needed, bool(cautions))
    differing = [d for d in differences if abs(d.z) > needed]
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


def _lone_findings(
    one: ComparableModel, other: ComparableModel, needed: float, errors_are_doubtful: bool
) -> tuple[LoneFinding, ...]:
    """Effects that only one of two diagnoses names; none where either run was not diagnosed.

    One decides if the other run would have named it, and its size is more than `needed` standard errors from zero, of
    which nothing may be doubtful.
    """
    if one.diagnosis is None or other.diagnosis is None:
        return ()
    sides = (("one", one, other), ("other", other, one))
    return tuple(
        LoneFinding(effect=name, found_in=side, sentence=effect.sentence, decides=not why, why_not=why)
        for side, found, without in sides
        for name, effect in found.findings.items()
        if name not in without.findings
        for why in (without.why_silent(effect) or _why_chance(effect, needed, errors_are_doubtful),)
    )


def _why_chance(effect: NamedEffect, needed: float, errors_are_doubtful: bool) -> str:
    """Why an effect may be named by chance, in words; empty where its size is beyond `needed` standard errors."""
    if errors_are_doubtful:
        return "the ± of these runs are not to be relied upon"
    sizes = [abs(q.value) / q.se for q in effect.parameters.values() if q.value is not None and q.se and not q.at_bound]
    if not sizes:
        return "the error of its size is not known"
    chance = f"its size is {max(sizes):.1f} standard errors from none, of which chance makes up to {needed:.1f}"
    return "" if max(sizes) > needed else chance


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
    found = [f"{plain_name(f.effect)} is found in the {PLACES[f.found_in]} only" for f in lone if f.decides]
    silent = [
        f"{plain_name(f.effect)} is found in the {PLACES[f.found_in]} only, which proves nothing, since {f.why_not}"
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
        if model.unresolved_causes:
            cautions.append(f"in the {place} diagnosis {model.unresolved_causes}: its ± may be too small")
    return cautions

"""The verdict of a diagnosis in a sentence."""

from bcid.documents.diagnosis import DiagnosisDocument, FitSummary, NamedEffect, OtherFigure, UnknownPart
from bcid.report import formats
from bcid.report.formats import plain_name, with_minus_sign
from bcid.report.limits import LIMITS

CHANNELS = {
    "fx": "forward force (fx)", "fy": "side force (fy)", "mz": "yaw moment (mz)", "steering": "steering",
    "motor": "motor", "pose": "tracked pose", "time": "timing of poses and commands",
}  # fmt: skip


FIGURES = {
    "K_t": ("the motor pushes", "more", "less"),
    "I_z": ("the moment of inertia is", "larger", "smaller"),
    "C_f": ("the front tyres are", "stiffer", "softer"),
    "C_r": ("the rear tyres are", "stiffer", "softer"),
    "F_f_max": ("the front tyres hold", "more", "less"),
    "F_r_max": ("the rear tyres hold", "more", "less"),
}
"""Words for a base parameter that is not as published: the subject and its verb, a larger value, a smaller one."""


def verdict_sentence(d: DiagnosisDocument) -> str:
    """The verdict of a diagnosis in a sentence: what was found, how large, and how much it helps on held-out data.

    A second sentence tells the figures of the simulation that are others here.
    """
    wordings = {"named": _word_named_effects, "ambiguous": _word_ambiguous_effects, "unknown": _word_unknown_effect}
    verdict = wordings.get(d.verdict, _word_absence_of_effects)(d)
    others = formats.join_words([_word_other_figure(f) for f in d.other_figures])
    return f"{verdict} Other than published: {others}." if others else verdict


def _word_other_figure(f: OtherFigure) -> str:
    """That a figure is another than published, in words.

    >>> from bcid.documents.diagnosis import Quantity
    >>> K_t = OtherFigure(symbol="K_t", published=25.0, needed=Quantity(value=21.5, se=0.3, unit="N"))
    >>> _word_other_figure(K_t)
    'the motor pushes 14 % less (K_t = 21.5 ± 0.3 N, published 25)'
    """
    needed, effect = f.needed.value or 0.0, f.symbol.partition("__")[0]
    size = formats.format_with_error(needed, f.needed.se, f.needed.unit)
    figures = f"{formats.symbol_text(f.symbol.rpartition('__')[2])} = {size}, published {f.published:.3g}"
    share = needed / f.published - 1.0 if f.published else 0.0
    if not -1.0 < share < 1.0 or not share:
        return f"{plain_name(effect)} ({figures})"
    subject, more, less = FIGURES.get(f.symbol, (f"{plain_name(effect)} is", "larger", "smaller"))
    return f"{subject} {abs(100.0 * share):.0f} % {more if share > 0.0 else less} ({figures})"


def short_take_sentence(d: DiagnosisDocument) -> str:
    """What a short take can show, in a sentence: its stretches, its gate, and which effects are too weak to be seen.

    Empty for a take of `LIMITS.short_stretches` stretches or more, and where the document does not say how many.

    >>> d = DiagnosisDocument(verdict="nothing-found", stretches=13, gate_nats=17.2)
    >>> short_take_sentence(d)
    'A short take: of 13 stretches of 1.5 s, what adds less than some 17 nats is hardly told from chance.'
    """
    if d.stretches is None or d.stretches >= LIMITS.short_stretches or d.gate_nats is None:
        return ""
    unseen = len({u.effect for u in d.not_excited})
    text = f"A short take: of {d.stretches} stretches of 1.5 s, what adds less than some {d.gate_nats:.0f}"
    text += " nats is hardly told from chance"
    if not unseen:
        return f"{text}."
    few = "effect shows only where it is" if unseen == 1 else "effects show only where they are"
    return f"{text}; {unseen} {few} unusually large, from the sizes listed on."


def _word_named_effects(d: DiagnosisDocument) -> str:
    """The verdict "named" as a sentence: all effects found, the improvement, and what remains unexplained."""
    kinds = {f.kind for f in d.findings}
    lead = "The recording is off, not the vehicle" if kinds == {"measurement"} else f"Missing in the {d.compared_with}"
    items = "; ".join(_describe_finding(f, kinds) for f in d.findings)
    return f"{lead}: {items}. {_describe_improvement(d, 'With it' if len(d.findings) == 1 else 'With them')}".rstrip()


def _word_ambiguous_effects(d: DiagnosisDocument) -> str:
    """The verdict "ambiguous" as a sentence: the effects found, each with others that explain the recording as well."""
    kinds = {f.kind for f in d.findings}
    alone = [_describe_finding(f, kinds) for f in d.findings if not f.twins]
    unclear = [
        f"{_describe_finding(f, kinds)}, or instead {formats.join_words(list(map(plain_name, f.twins)), 'or')}"
        for f in d.findings if f.twins
    ]  # fmt: skip
    certain = f"Missing in the {d.compared_with}: {'; '.join(alone)}. " if alone else ""
    more = "Something more" if alone else "Something"
    missing = f"{more} is missing, and this recording cannot tell which"
    if kinds == {"measurement"} and not alone:
        missing = "The recording is off, not the vehicle, though two causes would look the same"
    improvement = _describe_improvement(d, "With the first named" if len(d.findings) == 1 else "With those named first")
    return f"{certain}{missing}: {'; and: '.join(unclear)}. {improvement}".rstrip()


def _word_unknown_effect(d: DiagnosisDocument) -> str:
    """The verdict "unknown" as a sentence: something is missing that no named effect explains, and what is known."""
    if d.unknown:
        return f"Something is missing that no named effect explains: {_describe_unknown(d.unknown)}."
    names = ", ".join(plain_name(c.correction) for c in d.corrections)
    adjusted = f"; adjusting the base model's own simplifications ({names}) takes up part of it" if names else ""
    return f"Something is missing that no named effect explains{adjusted}."


def _word_absence_of_effects(d: DiagnosisDocument) -> str:
    """The verdict "nothing-found" as a sentence: how far the held-out error is above the noise floor.

    Where a mismatch is significant but no effect could be named, the sentence says that instead.
    """
    p = formats.format_p_value(d.mismatch.p_value)
    if d.mismatch.detected:
        return f"A mismatch is seen ({p}), but nothing that was tried explains it well enough to be named."
    stands_out = f", and no place or time stands out ({p})" if p else ""
    fit = d.fit
    if fit is None or fit.nmse_before is None or not fit.nmse_floor:
        return f"Nothing is missing beyond the noise floor{stands_out}."
    times = fit.nmse_before / fit.nmse_floor
    error = (
        f"{fit.horizon_s:g} s ahead the held-out error is {times:.2f} times what noise and random disturbances leave"
    )
    if times < LIMITS.above_floor:
        return f"Nothing is missing beyond the noise floor: {error}{stands_out}."
    return f"Nothing is found that is missing{stands_out}, and yet {error}. {_explain_floor_distance(d)}"


def _describe_finding(finding: NamedEffect, kinds: set[str]) -> str:
    """An effect with its parameters and standard errors as text, such as "motor lag, τ = 0.10 ± 0.03 s".

    Its kind is added where it is "measurement" or "environment", unless all `kinds` of the findings are
    "measurement".
    """
    kind = finding.kind
    kind_text = f" ({kind})" if kind in ("measurement", "environment") and kinds != {"measurement"} else ""
    values = ", ".join(
        f"{formats.symbol_text(symbol)} = {formats.format_with_error(p.value, p.se, p.unit)}"
        f"{' (at its bound)' if p.at_bound else ''}"
        for symbol, p in finding.parameters.items()
    )
    return f"{plain_name(finding.effect)}{kind_text}{', ' if values else ''}{values}"


def _describe_improvement(d: DiagnosisDocument, lead: str) -> str:
    """By how much the held-out error changes with the effects found, and what they leave; begins with `lead`."""
    fit = d.fit
    if fit is None or not fit.nmse_before or fit.nmse_after is None:
        return _describe_rest(d.unknown, in_error=True)
    text = f"{lead} the held-out {fit.horizon_s:g} s error (NMSE) {_describe_change(fit)}"
    times = fit.nmse_after / fit.nmse_floor if fit.nmse_floor else 0.0
    more = _describe_rest(d.unknown, in_error=not fit.nmse_floor or times >= LIMITS.above_floor)
    level = ", and stays at" if _hardly_changes(fit) else ", to"
    text += f"{level} {times:.2f} times the noise floor." if fit.nmse_floor else "."
    why = _explain_floor_distance(d) if times >= LIMITS.above_floor and not d.unknown else ""
    return " ".join(part for part in (text, _evidence_beside_error(d), why, more) if part)


def _describe_rest(unknown: UnknownPart | None, in_error: bool) -> str:
    """What is left beside the names, if anything; where it does not show `in_error`, what it shows in."""
    if unknown is None:
        return ""
    lead = "Something more" if in_error else "Too small to show in predictions, something more"
    return f"{lead} is left that no named effect explains: {_describe_unknown(unknown)}. So each ± is too small."


def _describe_change(fit: FitSummary) -> str:
    """By how much an error changes, as a verb with figures; that it hardly does where it is all but the same.

    >>> _describe_change(FitSummary(horizon_s=2.0, nmse_before=0.5, nmse_after=0.2, ratio_ci95=(0.3, 0.6)))
    'falls by 60 % (95 % interval 40 to 70 %)'
    >>> _describe_change(FitSummary(horizon_s=2.0, nmse_before=0.5, nmse_after=0.502, ratio_ci95=(0.98, 1.03)))
    'hardly changes (0 %, 95 % interval −2 % to +3 %)'
    """
    before, after = fit.nmse_before or 0.0, fit.nmse_after or 0.0
    if _hardly_changes(fit):
        low_high = (
            f", 95 % interval {' to '.join(map(formats.format_change, fit.ratio_ci95))}" if fit.ratio_ci95 else ""
        )
        return f"hardly changes ({formats.format_change(after / before)}{low_high})"
    sign, verb = (1.0, "falls") if after <= before else (-1.0, "rises")
    share = sign * 100.0 * (1.0 - after / before)
    text = f"{verb} by {share:.{0 if share < 99 else 1}f} %"
    if fit.ratio_ci95:
        low, high = sorted(sign * 100.0 * (1.0 - r) for r in fit.ratio_ci95)
        text += f" (95 % interval {with_minus_sign(f'{low:.0f}')} to {with_minus_sign(f'{high:.0f}')} %)"
    return text


def _hardly_changes(fit: FitSummary) -> bool:
    """Whether an error before and after differs by less than LIMITS.hardly_changed_share of itself."""
    before, after = fit.nmse_before or 0.0, fit.nmse_after or 0.0
    return abs(after - before) < LIMITS.hardly_changed_share * before


def _evidence_beside_error(d: DiagnosisDocument) -> str:
    """What the findings rest on where the error of predictions does not fall: the likelihood of the recorded poses.

    Empty where the error falls.
    """
    fit, gains = d.fit, [(f.heldout_gain, f.effect) for f in d.findings if f.heldout_gain is not None]
    if fit is None or fit.nmse_before is None or fit.nmse_after is None or not gains:
        return ""
    if fit.nmse_after < fit.nmse_before and not _hardly_changes(fit):
        return ""
    nats, effect = max(gains)
    if nats <= 0.0:
        return "Nor do the poses held out become likelier: take it with care."
    return (
        "What is named rests not on this error but on the likelihood of the recorded poses, which weighs them by the "
        f"sensor’s noise and sees much smaller differences: {plain_name(effect)} makes those held out {nats:.0f} nats "
        "likelier."
    )


def stays_above_floor(d: DiagnosisDocument) -> bool:
    """Whether the held-out error, with all that was found, is so far above the noise floor that a why is told."""
    fit = d.fit
    if fit is None or not fit.nmse_floor:
        return False
    last = fit.nmse_before if fit.nmse_after is None else fit.nmse_after
    return (last or 0.0) >= LIMITS.above_floor * fit.nmse_floor


def _explain_floor_distance(d: DiagnosisDocument) -> str:
    """What may keep the error above the noise floor where no part that lacks a name was reported, in a sentence."""
    left = max(d.remainder, key=lambda part: part.nats_left, default=None)
    if left is not None and left.nats_left > 0.0:
        return (
            "What keeps it above the floor has no name: most of what free functions still see acts on the "
            f"{CHANNELS.get(left.channel, left.channel)} ({left.nats_left:.1f} nats)."
        )
    return (
        "Neither an effect nor free functions explain what keeps it above the floor; events that are rare, such as "
        "bumps, or noise other than was assumed could do so."
    )


def _describe_unknown(unknown: UnknownPart) -> str:
    """Channel, dependence, and form or weight of what no named effect explains, as text."""
    channel = unknown.channel
    depends = formats.join_words([plain_name(n) for n in unknown.depends_on])
    text = f"it acts on the {CHANNELS.get(channel, channel)}" if channel else "its channel is not clear"
    text += f" and depends on {depends}" if depends else ""
    if unknown.form:
        return f"{text}; a short form fits it: {unknown.form}"
    return text + (f"; over all channels free functions gain {unknown.gain_nats:.0f} nats" if unknown.gain_nats else "")

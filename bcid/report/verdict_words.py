"""The verdict of a diagnosis in a sentence."""

from bcid.documents.diagnosis import DiagnosisDocument, NamedEffect, OtherFigure, UnknownPart
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
    'A short take: of 13 stretches of 1.5 s, what makes it likelier by less than 17 nats cannot be told from chance.'
    """
    if d.stretches is None or d.stretches >= LIMITS.short_stretches or d.gate_nats is None:
        return ""
    unseen = len({u.effect for u in d.not_excited})
    text = f"A short take: of {d.stretches} stretches of 1.5 s, what makes it likelier by less than {d.gate_nats:.0f}"
    text += " nats cannot be told from chance"
    if not unseen:
        return f"{text}."
    few = "effect shows only where it is" if unseen == 1 else "effects show only where they are"
    return f"{text}; {unseen} {few} unusually large, from the sizes listed on."


def _word_named_effects(d: DiagnosisDocument) -> str:
    """The verdict "named" as a sentence: all effects found, the improvement, and what remains unexplained."""
    kinds = {f.kind for f in d.findings}
    lead = "The recording is off, not the vehicle" if kinds == {"measurement"} else "Missing in the simulation"
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
    certain = f"Missing in the simulation: {'; '.join(alone)}. " if alone else ""
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
    figures = ""
    if d.fit and d.fit.nmse_before is not None and d.fit.nmse_floor:
        times = d.fit.nmse_before / d.fit.nmse_floor
        figures = f": {d.fit.horizon_s:g} s ahead the held-out error is {times:.2f} times what noise alone leaves"
    stands_out = f", and no place or time stands out ({p})" if p else ""
    return f"Nothing is missing beyond the noise floor{figures}{stands_out}."


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
    more = f"Something more is left that no named effect explains: {_describe_unknown(d.unknown)}." if d.unknown else ""
    fit = d.fit
    if fit is None or not fit.nmse_before or fit.nmse_after is None:
        return more
    before, after = fit.nmse_before, fit.nmse_after
    sign, verb = (1.0, "falls") if after <= before else (-1.0, "rises")
    share = sign * 100.0 * (1.0 - after / before)
    text = f"{lead} the held-out {fit.horizon_s:g} s error (NMSE) {verb} by {share:.{0 if share < 99 else 1}f} %"
    if fit.ratio_ci95:
        low, high = sorted(sign * 100.0 * (1.0 - r) for r in fit.ratio_ci95)
        text += f" (95 % interval {with_minus_sign(f'{low:.0f}')} to {with_minus_sign(f'{high:.0f}')} %)"
    if fit.nmse_floor:
        text += f", to {after / fit.nmse_floor:.2f} times the noise floor"
    return f"{text}. {more}"


def _describe_unknown(unknown: UnknownPart) -> str:
    """Channel, dependence, and form or weight of what no named effect explains, as text."""
    channel = unknown.channel
    depends = formats.join_words([plain_name(n) for n in unknown.depends_on])
    text = f"it acts on the {CHANNELS.get(channel, channel)}" if channel else "its channel is not clear"
    text += f" and depends on {depends}" if depends else ""
    if unknown.form:
        return f"{text}; a short form fits it: {unknown.form}"
    return text + (f"; free functions explain it by {unknown.gain_nats:.0f} nats" if unknown.gain_nats else "")

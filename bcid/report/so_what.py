"""What a diagnosis comes to, in plain sentences: how large each finding is, what is left and why, what to do next."""

from collections.abc import Sequence
from math import exp, log

from bcid.documents.diagnosis import DiagnosisDocument, NamedEffect
from bcid.documents.error_budget import ErrorShare
from bcid.report.budget_words import percent, percent_range
from bcid.report.drive_words import describe_drive
from bcid.report.everyday_words import size_in_words
from bcid.report.formats import format_number, join_words, plain_name
from bcid.report.limits import LIMITS
from bcid.report.verdict_words import CHANNELS, stays_above_floor

REMEDIES = {
    "vehicle": "mend the car, or leave it as it is and predict with the model in model/",
    "environment": "change the floor there, or leave it as it is and predict with the model in model/",
    "measurement": "correct the recording for it before anything is fitted, since the car itself is not like that",
}
"""What to do about a finding, by its kind."""


def finding_sentences(d: DiagnosisDocument) -> list[str]:
    """One sentence for each finding: how large it is in everyday words, and its share of the error where that is known.

    Those that make most of the error come first.  A finding without a phrase of its own is called by its name.
    """
    parts = [(f, _share_of(d, f.effect)) for f in d.findings]
    parts.sort(key=lambda pair: -pair[1].share if pair[1] else 0.0)
    return [_finding_sentence(f, part) for f, part in parts]


def _finding_sentence(finding: NamedEffect, part: ErrorShare | None) -> str:
    """How large a finding is, and what it makes of the error."""
    words = size_in_words(finding) or plain_name(finding.effect)
    text = f"{words[0].upper()}{words[1:]}"
    if finding.twins:
        text += f", or it is {join_words([plain_name(n) for n in finding.twins], 'or')} instead"
    if part is None:
        return f"{text}."
    if part.share < LIMITS.told_share:
        odds = f", though it makes the recorded poses {_times(finding.gain_nats)} likelier" if finding.gain_nats else ""
        return f"{text}. That takes next to nothing off the error so far ahead{odds}."
    own = "That makes" if len(part.effects) == 1 else f"With {join_words(_others(finding, part))} that makes"
    return f"{text}. {own} {percent(part.share)} of the error (95 % interval {percent_range(*part.ci95)})."


def _times(nats: float) -> str:
    """How many times likelier a gain of log-likelihood makes something, in words.

    >>> _times(2.0), _times(40.0)
    ('7.4 times', 'more than a million times')
    """
    return "more than a million times" if nats > log(1e6) else f"{format_number(exp(max(nats, 0.0)), 2)} times"


def _others(finding: NamedEffect, part: ErrorShare) -> list[str]:
    """The findings that share a part of the error with this one, in words."""
    return [plain_name(name) for name in part.effects if name != finding.effect]


def _share_of(d: DiagnosisDocument, effect: str) -> ErrorShare | None:
    """The part of the error that an effect makes; None where the document has none."""
    parts = d.error_budget.parts if d.error_budget else ()
    return next((p for p in parts if p.cause == "effect" and effect in p.effects), None)


def remainder_sentences(d: DiagnosisDocument) -> list[str]:
    """What is left of the error, and why, as far as the recording says."""
    sentences, certain = [], True
    left = {p.cause: p for p in d.error_budget.parts} if d.error_budget else {}
    if "left-noise-included" in left:
        rest = left["left-noise-included"]
        sentences.append(
            f"{percent(rest.share)} of the error (95 % interval {percent_range(*rest.ci95)}) are left, noise included: "
            "how much of them is noise is not known, since the fitted car does not drive the whole take in simulation."
        )
    if "unexplained" in left:
        rest = left["unexplained"]
        certain = rest.ci95[0] > LIMITS.told_share
        sentences.append(
            f"{percent(rest.share)} of the error (95 % interval {percent_range(*rest.ci95)}) stay unexplained."
            if certain
            else f"Of the error {percent(max(rest.share, 0.0))} are left above the noise floor, which chance may make."
            if stays_above_floor(d)
            else "Nothing of the error is left for certain beyond what noise and random disturbances make."
        )
    if d.unknown:
        sentences.append(_unknown_sentence(d, in_error=certain))
    chance = [left[c] for c in ("noise", "disturbances") if c in left]
    disturbed = next((p for p in chance if p.cause == "disturbances"), None)
    if disturbed and disturbed.ci95[0] > LIMITS.told_share:
        sentences.append(
            f"{percent(disturbed.share)} are disturbances that come and go within a second, and that no "
            "function of motion and commands predicts: bumps of the floor, a loose part, or physics not in the log."
        )
    return sentences


def _unknown_sentence(d: DiagnosisDocument, in_error: bool) -> str:
    """That something is left without a name, where it acts, and what that does to the other numbers.

    Where it does not show for certain `in_error`, the sentence says what it shows in.
    """
    u = d.unknown
    channel = CHANNELS.get(u.channel or "", u.channel or "") if u else ""
    depends = join_words([plain_name(n) for n in u.depends_on]) if u else ""
    where = f" on the {channel}" if channel else ""
    where += f", with the {depends}" if depends else ""
    still = "still " if d.findings else ""
    lead = "Something" if in_error else "In the recorded poses, which show more than this error does, something"
    return (
        f"{lead} without a name {still}acts{where}: so ± are too small, since they hold only where nothing is missing."
    )


def next_sentences(d: DiagnosisDocument) -> list[str]:
    """What to do next: about the findings, about what is not told apart, and about what the drive did not show."""
    unclear = [f for f in d.findings if f.twins]
    sentences = _drive_sentences(d, unclear) if unclear else []
    for kind, remedy in REMEDIES.items():
        names = [plain_name(f.effect) for f in d.findings if f.kind == kind and not f.twins]
        if names:
            sentences.append(f"For {join_words(names)}: {remedy}.")
    if d.findings or d.corrections:
        what = "all that was found" if d.findings else "its simplifications put right"
        sentences.append(
            f"The car with {what} lies in the folder model/; bcid export, given that folder, writes it as code."
        )
    elif not d.unknown and not d.mismatch.detected and not stays_above_floor(d):
        sentences.append("Nothing needs to be mended: the model is as good as these measurements.")
    if not unclear:
        sentences += _drive_sentences(d, unclear)
    if d.verdict == "unknown" or (d.unknown and not unclear):
        sentences.append(
            "Look at the car and its floor for what is none of the effects that have names (bcid effects lists them); "
            "drive once more on another day: what is of the car comes back, what is of the day does not."
        )
    return sentences + _unseen_sentences(d)


def _drive_sentences(d: DiagnosisDocument, unclear: Sequence[NamedEffect]) -> list[str]:
    """Which drive tells findings and their rivals apart; `unclear` are those that this recording does not."""
    drive = d.next_manoeuvre
    if drive and drive.file:
        return [describe_drive(drive, urgent=bool(unclear))]
    names = join_words([plain_name(n) for f in unclear for n in (f.effect, *f.twins)], "from")
    return [f"Drive what tells {names}, and diagnose both takes together."] if unclear else []


def _unseen_sentences(d: DiagnosisDocument) -> list[str]:
    """Which effects the drive hardly excites, and how to make one that does."""
    unseen = list(dict.fromkeys(n.effect for n in d.not_excited))
    if not unseen:
        return []
    few = unseen[: LIMITS.told_effects]
    others = [f"{len(unseen) - len(few)} more"] if len(unseen) > len(few) else []
    shown, them = join_words([*map(plain_name, few), *others]), "it" if len(unseen) == 1 else "them"
    return [
        f"This drive hardly excites {shown}, and shows {them} only if unusually large: "
        f"bcid plan {' '.join(few)} --vehicle VEHICLE.toml makes a drive that shows {them}."
    ]

"""What is told of a take in a view, as log messages: each finding at the time at which it helps most."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.diagnosis.locate.pushes import WRENCH_CHANNELS
from bcid.documents.diagnosis import NamedEffect
from bcid.effects.table import EFFECTS
from bcid.likelihood.take import KNOT_S
from bcid.recording.checks.contacts import find_contacts
from bcid.recording.types import Recording
from bcid.report.formats import format_with_error, plain_name, symbol_text
from bcid.report.verdict_words import verdict_sentence
from bcid.view.content import Diagnosed, ViewContent
from bcid.view.messages import INFO, WARNING

PUSHED_CHANNELS = {"fx": ("fx",), "motor": ("fx",), "fy": ("fy",), "mz": ("mz",)}
"""The components of a push that an effect of each channel changes; one of any other channel may change all."""


class LoggedText(NamedTuple):
    """A text, when it is told (s, on the recording's clock), what it is about, and its level."""

    time_s: float
    text: str
    subject: str
    level: int = INFO


def logged_texts(content: ViewContent) -> list[LoggedText]:
    """All that is told of a take, in the order of time: verdict, findings, irregularities and contacts."""
    recording, begin_s = content.recording, float(content.recording.poses.time_s[0])
    texts = [_describe_irregularities(recording, begin_s), *_describe_contacts(recording, begin_s)]
    if content.diagnosed is not None:
        document, end_s = content.diagnosed.document, float(recording.poses.time_s[-1])
        texts.append(LoggedText(begin_s, verdict_sentence(document), "verdict"))
        for finding in document.findings:
            at_s = min(finding_time_s(finding, content.diagnosed, begin_s), end_s)
            texts.append(LoggedText(at_s, _describe_effect(finding), finding.effect))
        if document.unknown is not None and document.unknown.channel is not None:
            at_s = min(largest_push_time_s(document.unknown.channel, content.diagnosed, "after"), end_s)
            text = f"largest here of what has no name ({document.unknown.channel})"
            texts.append(LoggedText(at_s, text, "unknown", WARNING))
    return sorted((t for t in texts if t.text), key=lambda t: t.time_s)


def _describe_irregularities(recording: Recording, begin_s: float) -> LoggedText:
    """What was odd about a recording, in one text; empty where nothing was."""
    odd = [f"{i.kind} ({i.action}, {i.count}): {i.where}: {i.detail}" for i in recording.irregularities]
    return LoggedText(begin_s, "\n".join(odd), "recording", WARNING)


def _describe_contacts(recording: Recording, begin_s: float) -> list[LoggedText]:
    """The bumps and crashes in a recording that begins at `begin_s` (s); a diagnosis leaves their time out."""
    return [
        LoggedText(begin_s + c.begin_s, f"{c.kind} at x = {c.x_m:.2f} m, y = {c.y_m:.2f} m", "contact", WARNING)
        for c in find_contacts(recording)
    ]


def _describe_effect(finding: NamedEffect) -> str:
    """A named effect with its size, and why it is told at this time."""
    sizes = ", ".join(
        f"{symbol_text(symbol)} = {format_with_error(size.value, size.se, size.unit)}"
        for symbol, size in finding.parameters.items()
    )
    return f"{plain_name(finding.effect)}: {sizes}. Here the push in its channel shrinks most once effects are named"


def finding_time_s(finding: NamedEffect, diagnosed: Diagnosed, begin_s: float) -> float:
    """The time (s) of the recording at which naming an effect helps most.

    It is the middle of the knot at which the push in the effect's channel falls most from before to after all names
    are given, among the knots at which the effect acts: in its circle, and after its beginning, where it has them.
    """
    knots = diagnosed.knots
    entry = EFFECTS.get(finding.effect)
    values = {symbol: q.value for symbol, q in finding.parameters.items()}
    acting = _acting_knots(values, knots, begin_s)
    if not acting.any():
        return begin_s
    channels = PUSHED_CHANNELS.get(entry.channel if entry else "any", WRENCH_CHANNELS)
    gain = _push_size(knots, channels, "before", "before") - _push_size(knots, channels, "after", "before")
    return float(knots["time_s"][acting][np.argmax(gain[acting])])


def largest_push_time_s(channel: str, diagnosed: Diagnosed, stage: str) -> float:
    """The time (s) of the recording at which the push in a channel is largest, before or after names are given."""
    channels = PUSHED_CHANNELS.get(channel, WRENCH_CHANNELS)
    return float(diagnosed.knots["time_s"][np.argmax(_push_size(diagnosed.knots, channels, stage, stage))])


def _push_size(knots: Mapping[str, Floats], channels: tuple[str, ...], stage: str, unit_stage: str) -> Floats:
    """The sizes (K,) of pushes in a `stage`, each component by its root mean square in the stage `unit_stage`."""
    parts = [
        knots[f"{stage}_{c}"] / max(float(np.sqrt(np.mean(knots[f"{unit_stage}_{c}"] ** 2))), 1e-12) for c in channels
    ]
    return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))


def _acting_knots(values: Mapping[str, float | None], knots: Mapping[str, Floats], begin_s: float) -> Bools:
    """Which knots (K,) lie where and when an effect acts, by its parameters x, y, radius (m) and t (s)."""
    x, y, radius, t = (values.get(symbol) for symbol in ("x", "y", "radius", "t_s"))
    acting = np.ones(len(knots["time_s"]), dtype=bool)
    if x is not None and y is not None and radius is not None:
        acting &= np.hypot(knots["x"] - x, knots["y"] - y) <= radius
    if t is not None:
        acting &= knots["time_s"] - 0.5 * KNOT_S >= begin_s + t
    return acting

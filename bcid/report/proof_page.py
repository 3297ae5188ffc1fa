"""The page of a blind test and its figures, from its JSON alone."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from bcid.documents.prove import Calibration, MethodScores, ProveDocument, TierScores
from bcid.effects.table import EFFECTS
from bcid.report.canvas import AFTER, INK, MUTED, TEXT_SIZE, create_panel, render_svg, style_axes
from bcid.report.templates import write_page

COLUMNS = {
    "right": "right", "first": "top1", "in the set": "set", "exact": "exact", "false alarms": "false",
    "unknown": "unknown", "wrong name": "wrong", "in its channel": "channel", "reported as not excited": "not_seen",
    "measurement recognised": "kind", "located": "located", "place": "place_overlap", "time": "time_overlap",
    "set size": "set_size", "parameter error": "parameter_error", "95 % intervals hold": "coverage",
    "oracle's gain": "oracle_share", "not shown": "unshown", "shown, reported as not excited": "denied",
    "more named beside": "more",
    "errors": "errors", "seconds": "seconds",
}  # fmt: skip
PLAIN_NUMBERS = ("set_size", "seconds", "place_overlap", "time_overlap", "errors")
"""Fields that are numbers and not shares of takes."""

SHOWN_IF_ANY = ("errors", "unshown")
"""Fields that are shown only where they are not zero."""

TITLES = {
    "null": "nothing", "null-imperfect": "nothing, imperfect base", "single": "one effect",
    "single-imperfect": "one effect, imperfect base", "half-size": "one effect of half the size",
    "double-size": "one effect of twice the size", "pair": "two effects", "triple": "three effects",
    "measurement-and-vehicle": "an effect of the measurement and one of the vehicle",
    "left-out": "one effect that may not be named", "outside": "an effect outside the vocabulary",
    "unexcited": "an effect that the drive does not excite", "closed-loop": "one effect, a driver who follows a path",
    "two-minutes": "one effect, two minutes", "thirty-minutes": "one effect, thirty minutes",
    "ten-hertz": "one effect, poses at 10 Hz", "hundred-twenty-hertz": "one effect, poses at 120 Hz",
    "three-times-noise": "one effect, three times the noise",
    "small-exact": "small car: one effect less than it has", "small-plus": "small car: one effect more",
    "small-null": "small car: nothing", "small-wrong": "small car: one effect less, four other things wrong",
    "small-outside": "small car: an effect outside the vocabulary",
    "other-laws": "small car of other formulas than published: nothing",
    "other-laws-less": "small car of other formulas than published: one effect less",
    "other-day": "small car on another day than published: nothing",
    "other-day-less": "small car on another day than published: one effect less",
    "tricycle": "tricycle, forward and backward: one effect or two",
}  # fmt: skip
"""What is concealed in the takes of a tier; they last ten minutes at 60 Hz where nothing else is said, those of small
cars one to three."""

METHOD_FIGURES = {
    "first": "top1", "detects": "detected", "false alarms": "false", "of the error explained": "explained",
    "failed": "failed",
}  # fmt: skip
"""Figures that are shown of each method on the same takes, by their titles."""


def format_cell(tier: TierScores, field: str, marked: str = "**{}** missed") -> str:
    """The score `field` of a tier (one kind of blind case) as text, with its 95 % interval and goal where they exist.

    A score outside its goal is put into `marked`, a format string.
    """
    value, goal = tier.score(field), tier.goal.get(field)
    if value is None:
        return "–"  # nothing in the tier asks for it
    text = _format_figure(value, field)
    if interval := getattr(tier, f"{field}_ci95", None):
        text += " [{:.3g} to {:.3g}]".format(*(100.0 * end for end in interval))
    if field in tier.missed:
        text = marked.format(text)
    return f"{text} ({_format_goal(goal[0], goal[1], field)})" if goal else text


def _format_figure(value: float, field: str) -> str:
    """A score as a percentage with "%", or as a plain number where `field` is no share of cases."""
    if field in PLAIN_NUMBERS:
        return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"
    return f"{100.0 * value:.3g}\N{NO-BREAK SPACE}%"


def _format_goal(low: float, high: float, field: str) -> str:
    """The goal `low` to `high` of the score `field` as text: a range, or one bound where the other is 0 or 1."""
    if low > 0.0 and high < 1.0:
        return f"{_format_figure(low, field)} to {_format_figure(high, field)}"
    sign, end = ("≥", low) if low > 0.0 else ("≤", high)
    return f"{sign}\N{NO-BREAK SPACE}{_format_figure(end, field)}"


def filled_columns(tiers: Sequence[TierScores]) -> dict[str, str]:
    """Columns, as title and score field, of the table of blind cases in which any tier (kind of case) has a value."""
    return {
        title: f
        for title, f in COLUMNS.items()
        if any((value := t.score(f)) is not None and (f not in SHOWN_IF_ANY or value > 0) for t in tiers)
    }


def tier_figures(tier: TierScores, columns: Mapping[str, str], marked: str) -> str:
    """All scores of a tier (kind of blind case), by `columns`, as a line of text; misses are formatted by `marked`."""
    cells = {title: format_cell(tier, field, marked) for title, field in columns.items()}
    return "; ".join(f"{title} {text}" for title, text in cells.items() if text != "–")


def suite_options(outcome: ProveDocument) -> str:
    """The command-line options that generate the cases of a blind test again.

    >>> suite_options(ProveDocument.model_construct(seed=7, sizes={"repeats": 3, "nulls": 20, "every": 2}))
    '--seed 7 --repeats 3 --nulls 20'
    """
    sizes = {name.replace("_", "-"): n for name, n in outcome.sizes.items() if name != "every"}
    return " ".join([f"--seed {outcome.seed}", *(f"--{name} {n}" for name, n in sizes.items())])


def count_takes(outcome: ProveDocument, tier: str) -> str:
    """How many cases of a tier (kind of blind case) were run, as text, with their full number where some were not.

    >>> tiers = (TierScores(tier="null", n=3, right=1.0, unknown=0.0, errors=0),)
    >>> run = ProveDocument.model_construct(tiers=tiers, tiers_of={"null": 5, "pair": 2})
    >>> count_takes(run, "null"), count_takes(run, "pair")
    ('3 of 5', '0 of 2')
    """
    n = next((t.n for t in outcome.tiers if t.tier == tier), 0)
    whole = outcome.tiers_of.get(tier, n)
    return str(n) if n == whole else f"{n} of {whole}"


def tiers_not_run(outcome: ProveDocument) -> list[str]:
    """Names of the tiers (kinds of blind case) of which a partial run has no case."""
    return [tier for tier in outcome.tiers_of if tier not in {t.tier for t in outcome.tiers}]


def tier_title(tier: str) -> str:
    """What is concealed in the recordings of a tier (kind of blind case), in words, such as "one effect"."""
    return TITLES.get(tier, tier)


def error_ratio_text(row: Mapping[str, Any], form: str) -> str:
    """By which factor an error rises when an effect is withheld, in the format `form`, from a result's "ratio".

    It is "endless" where the simulation without the effect diverges (ratio None), and a dash where none was
    computed.

    >>> [error_ratio_text(row, "× {:.2f}") for row in ({"ratio": 1.967}, {"ratio": None}, {})]
    ['× 1.97', 'endless', '–']
    """
    if "ratio" not in row:
        return "–"
    return "endless" if row["ratio"] is None else form.format(row["ratio"])


def method_figure(method: MethodScores, field: str) -> str:
    r"""A figure of a baseline method as text: a count of takes, a share or a number; a dash where it has none.

    >>> net = MethodScores(method="net", n=13, detected=(12, 13), explained=0.717, failed=0)
    >>> fields = ("top1", "detected", "explained", "failed")
    >>> [method_figure(net, field).replace("\N{NO-BREAK SPACE}", " ") for field in fields]
    ['–', '12 of 13', '71.7 %', '0']
    """
    value = getattr(method, field)
    if value is None:
        return "–"  # such a method fits, and cannot name
    if isinstance(value, Sequence):
        return f"{value[0]} of {value[1]}"
    return _format_figure(value, field) if isinstance(value, float) else str(value)


def write_proof_page(outcome: ProveDocument, path: Path) -> None:
    """Write the HTML page of a blind test's outcome to `path`, with tables and figures and no outside resource."""
    columns = filled_columns(outcome.tiers)
    rows = [
        {
            "tier": tier_title(t.tier),
            "n": count_takes(outcome, t.tier),
            "cells": [(format_cell(t, f, "{} missed"), f in t.missed) for f in columns.values()],
        }
        for t in outcome.tiers
    ]
    write_page(
        path, "proof.html.j2", {}, o=outcome, again=suite_options(outcome), columns=list(columns), rows=rows,
        not_run=list(map(tier_title, tiers_not_run(outcome))),
        whole=outcome.of or outcome.cases,
        said=METHOD_FIGURES, said_by=method_figure,
        confusion=draw_confusion(outcome.confusion),
        calibration=draw_calibration(outcome.calibration) if outcome.calibration.bins else None,
    )  # fmt: skip


def draw_confusion(confusion: Mapping[str, Mapping[str, int]]) -> Markup:
    """Confusion matrix of a blind test, effect concealed against effect answered first, as an SVG element.

    `confusion` maps the concealed effect to counts by answer, among them "unknown", "nothing" and "error".
    """
    known = [e for e in EFFECTS if e in confusion]
    more = [e for e in confusion if e not in EFFECTS]
    truths = [*known, *more]
    answered = [e for e in EFFECTS if e in known or any(e in answers for answers in confusion.values())]
    answers = [*answered, "unknown", "nothing", "error"]
    counts = np.array([[confusion[t].get(a, 0) for a in answers] for t in truths], dtype=float)
    counts = counts.reshape(len(truths), len(answers))
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    figure = Figure(figsize=(10.5, 1.5 + 0.2 * len(truths)), layout="constrained")
    ax = figure.subplots()
    # pale enough, over white as over black, for the page's ink to be read upon it
    shade = LinearSegmentedColormap.from_list("shade", [(0.0, 0.4, 0.75, 0.1), (0.0, 0.4, 0.75, 0.5)])
    ax.imshow(np.ma.masked_equal(shares, 0.0), cmap=shade, vmin=0.0, vmax=1.0, aspect="auto", interpolation="nearest")
    style_axes(ax)
    ax.set_xticks(range(len(answers)), [a.replace("_", " ") for a in answers], rotation=90, fontsize=8)
    ax.set_yticks(range(len(truths)), [t.replace("_", " ") for t in truths], fontsize=8)
    for i, j in zip(*np.nonzero(counts), strict=True):
        ax.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=8, color=INK)
    ax.set_xlabel("answered first")
    ax.set_ylabel("concealed alone")
    return render_svg(figure, "What was concealed against what was answered first")


def draw_calibration(calibration: Calibration) -> Markup:
    """Reliability diagram of a blind test: findings' stated probability against the share correct, as an SVG element.

    Findings are grouped in bins of their stated probability; a finding is correct if its effect was in the recording.
    """
    figure, ax = create_panel(3.6)
    ax.plot([0, 1], [0, 1], color=MUTED, lw=1, ls="--")
    bins = calibration.bins
    ax.plot([b.stated for b in bins], [b.there for b in bins], "o", color=AFTER)
    for b in bins:
        if b.there_ci95:
            ax.plot([b.stated] * 2, b.there_ci95, color=AFTER, lw=1)
        ax.annotate(
            f"{b.n:.0f}", (b.stated, b.there), textcoords="offset points", xytext=(-6, -10), ha="right", color=INK,
            fontsize=TEXT_SIZE - 0.5,
        )  # fmt: skip
    ax.set_xlabel("stated probability")
    ax.set_ylabel("share that was there")
    ax.set_xlim(0, 1.03)
    ax.set_ylim(0, 1.03)
    return render_svg(figure, "Stated probability against the share that was there")

"""The error budget of a diagnosis in words: the rows of a table, and of a bar."""

from collections.abc import Sequence
from typing import NamedTuple

from bcid.documents.error_budget import ErrorBudget, ErrorShare
from bcid.report.formats import join_words, plain_name, with_minus_sign

EFFECT_COLOURS = tuple(f"var(--part-{k})" for k in range(1, 6))
"""Colours of named effects, the first named first, as variables of the stylesheet, which is light or dark."""

CAUSES = {
    "corrections": ("the base model’s own simplifications", "var(--corrections)"),
    "noise": ("noise of the poses", "var(--noise)"),
    "disturbances": ("disturbances that look random", "var(--disturbances)"),
    "unexplained": ("unexplained", "var(--unexplained)"),
    "left-noise-included": ("left, noise included", "var(--unexplained)"),
}
"""What else makes a part of the error, in words, and its colour."""


class BudgetRow(NamedTuple):
    """One part of the error, as the table shows it."""

    label: str
    colour: str
    share: str
    interval: str
    remark: str  # that the share may be nothing, or is less; empty of any other
    length: float  # of its piece of the bar, percent of the whole bar; none where chance makes the share negative


def describe_cause(part: ErrorShare) -> str:
    """What makes a part of the error, in words."""
    if part.cause != "effect":
        return CAUSES[part.cause][0]
    return join_words([plain_name(name) for name in part.effects])


def budget_rows(budget: ErrorBudget) -> list[BudgetRow]:
    """The parts of the error with their shares of it and the intervals of these."""
    colours, whole = _part_colours(budget.parts), sum(max(p.share, 0.0) for p in budget.parts)
    return [
        BudgetRow(
            describe_cause(p),
            colour,
            percent(p.share),
            percent_range(*p.ci95),
            describe_sign(p),
            100.0 * max(p.share, 0.0) / whole,
        )
        for p, colour in zip(budget.parts, colours, strict=True)
    ]


def describe_sign(part: ErrorShare) -> str:
    """What it means that a share may be zero, or is below it, in words; empty where it is above zero for certain."""
    low, high = part.ci95
    if low > 0.0:
        return ""
    return "not distinguishable from nothing" if high >= 0.0 else "makes the error larger"


def percent(share: float) -> str:
    """A share as a text in percent: to whole ones, and to tenths below ten.

    >>> percent(0.413), percent(0.0123), percent(-0.002), percent(0.0004)
    ('41 %', '1.2 %', '−0.2 %', '0.0 %')
    """
    value = 100.0 * share
    text = f"{value:.{0 if abs(value) >= 9.95 else 1}f}"
    return with_minus_sign(f"{'0.0' if text == '-0.0' else text} %")


def percent_range(low: float, high: float) -> str:
    """An interval of shares as a text in percent.

    >>> percent_range(0.463, 0.529), percent_range(-0.01, 0.2)
    ('46 to 53 %', '−1.0 to 20 %')
    """
    return f"{percent(low).removesuffix(' %')} to {percent(high)}"


def _part_colours(parts: Sequence[ErrorShare]) -> list[str]:
    """A colour for each part, those of effects in their order."""
    effects = iter(EFFECT_COLOURS * (1 + len(parts) // len(EFFECT_COLOURS)))
    return [next(effects) if p.cause == "effect" else CAUSES[p.cause][1] for p in parts]

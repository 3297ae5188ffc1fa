"""Figures of the answers about real recordings, each with its exact interval, beside the goals of issue 42."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bcid.documents.prove_real import RealFigure, RealProofDocument
from bcid.proof.limits import REAL_GOALS
from bcid.proof.scores.tiers import binomial_ci95

Row = Mapping[str, Any]


def real_document(rows: Sequence[Row], code: str) -> RealProofDocument:
    """The document real.json of scored rows about real recordings, made by code of the digest `code`."""
    figures = tuple(with_goals(real_figures(rows)))
    missed = tuple(f"{f.figure}: {describe_figure(f)}" for f in figures if f.missed)
    return RealProofDocument(code=code, figures=figures, rows=tuple(map(dict, rows)), missed=missed)


def real_figures(rows: Sequence[Row]) -> list[RealFigure]:
    """All figures of scored rows, without their goals; those of no row have no value."""
    tiers: dict[str, list[Row]] = {}
    for row in rows:
        tiers.setdefault(row["tier"], []).append(row)
    withheld, pairs, replicated = (tiers.get(name, []) for name in ("withheld", "transfer", "replication"))
    asked = [row for row in withheld if "error" not in row]
    spent = [row["cpu_s_per_minute"] for row in rows if "cpu_s_per_minute" in row]
    return [
        RealFigure(figure="withheld: questions with an answer", n=len(withheld), value=len(asked) if rows else None),
        _share("withheld: right", withheld, "right"),
        _share("withheld: named first", withheld, "first"),
        _mean_count("withheld: false names a question", [len(row["false"]) for row in asked]),
        _share("controls: right", tiers.get("control", []), "right"),
        _mean_count("controls: false names a question", [len(row["false"]) for row in tiers.get("control", [])]),
        _share("edits: found, with their size", tiers.get("edited", []), "right"),
        _share("replication: same names and sizes", [r for r in replicated if not r.get("empty")], "right"),
        RealFigure(
            figure="replication: pairs without a name", n=len(replicated),
            value=sum(r.get("empty", False) for r in replicated) if replicated else None,
        ),
        _share("transfer: augmented below base", pairs, "below_base"),
        _share("transfer: augmented best of all", pairs, "best"),
        _share("another start: other answer", tiers.get("start", []), "differs"),
        _share("three quarters of the drive: other answer", tiers.get("part", []), "differs"),
        RealFigure(
            figure="CPU seconds a minute of drive, median", n=len(spent),
            value=float(np.median(spent)) if spent else None,
        ),
    ]  # fmt: skip


def with_goals(figures: Iterable[RealFigure]) -> list[RealFigure]:
    """The figures with their goals, and whether each misses it; a figure without a value misses none."""
    told = []
    for figure in figures:
        goal = REAL_GOALS.get(figure.figure)
        missed = goal is not None and figure.value is not None and not goal[0] <= figure.value <= goal[1]
        told.append(figure.model_copy(update={"goal": goal, "missed": missed}))
    return told


def describe_figure(figure: RealFigure) -> str:
    """A figure in words: hits of n or its value, its interval and goal.

    >>> describe_figure(RealFigure(figure="right", n=10, hits=9, value=0.9, ci95=(0.555, 0.997), goal=(0.9, 1.0)))
    '9 of 10 (0.555 to 0.997), wanted at least 0.9'
    >>> describe_figure(RealFigure(figure="false", n=4, value=0.25, goal=(0.0, 0.3)))
    '0.25 (n = 4), wanted at most 0.3'
    """
    if figure.value is None:
        return "–"
    told = f"{figure.hits:g} of {figure.n}" if figure.hits is not None else f"{figure.value:.3g} (n = {figure.n})"
    if figure.ci95 is not None:
        told += f" ({figure.ci95[0]:.3g} to {figure.ci95[1]:.3g})"
    if figure.goal is not None:
        low, high = figure.goal
        told += f", wanted at least {low:g}" if low > 0.0 else f", wanted at most {high:g}"
    return told


def _share(name: str, rows: Sequence[Row], field: str) -> RealFigure:
    """The share of rows whose `field` is true, with its exact interval; a row that failed has none and is a miss."""
    hits, n = sum(bool(row.get(field, field == "differs")) for row in rows), len(rows)
    if not n:
        return RealFigure(figure=name, n=0)
    return RealFigure(figure=name, n=n, hits=hits, value=hits / n, ci95=binomial_ci95(hits, n))


def _mean_count(name: str, counts: Sequence[int]) -> RealFigure:
    """The mean of counts, with the exact interval of a Poisson law (Garwood 1936) for their sum."""
    from scipy.stats import chi2

    n, total = len(counts), sum(counts)
    if not n:
        return RealFigure(figure=name, n=0)
    low = float(chi2.ppf(0.025, 2 * total)) / 2.0 if total else 0.0
    high = float(chi2.ppf(0.975, 2 * total + 2)) / 2.0
    return RealFigure(figure=name, n=n, value=total / n, ci95=(low / n, high / n))

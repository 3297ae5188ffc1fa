"""Calibration: whether stated probabilities and p-values hold."""

import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np

from bcid.documents.prove import Calibration, CalibrationBin, NullPValues
from bcid.proof.limits import LIMITS
from bcid.proof.scores.tiers import binomial_ci95

PROBABILITY_EDGES = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)


def calibration(rows: Iterable[dict[str, Any]]) -> Calibration:
    """Calibration of stated probabilities: mean probability and share of true names in bins, and the Brier score.

    A blind case's row has "findings" (named effects, each with its "probability") and "answer" (ids of the concealed
    effects), perhaps "also" (effects there besides).  Any name for an effect that the diagnosis cannot name, or that
    was excluded, is false.
    """
    stated, there = [], []
    for row in rows:
        for finding in row.get("findings", []):
            stated.append(finding["probability"])
            there.append(float(finding["effect"] in (*row["answer"], *row.get("also", ()))))
    p, y = np.array(stated), np.array(there)
    bins = []
    for low, high in itertools.pairwise(PROBABILITY_EDGES):
        inside = (p > low) & (p <= high) if len(p) else np.zeros(0, dtype=bool)
        if inside.any():
            n, hits = int(inside.sum()), int(y[inside].sum())
            bins.append(CalibrationBin(
                low=low, high=high, n=n, stated=float(p[inside].mean()), there=float(y[inside].mean()),
                there_ci95=binomial_ci95(hits, n),
            ))  # fmt: skip
    return Calibration(n=len(p), brier=float(np.mean((p - y) ** 2)) if len(p) else None, bins=tuple(bins))


def null_p_values(rows: Iterable[dict[str, Any]]) -> NullPValues | None:
    """Share of null recordings (no effect, perfect base model) with a p-value of at most `LIMITS.null_p_level`.

    The share should equal the level if p-values are exact.  Reads "tier" (must be "null") and "p_value" of the rows;
    None if there are no such rows.
    """
    p = [row["p_value"] for row in rows if row["tier"] == "null" and "p_value" in row]
    low = sum(value <= LIMITS.null_p_level for value in p)
    if not p:
        return None
    return NullPValues(n=len(p), level=LIMITS.null_p_level, share=low / len(p), ci95=binomial_ci95(low, len(p)))

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
    """Calibration of the probabilities of all findings; any name for a left-out or unknown effect counts as wrong."""
    stated, there = [], []
    for row in rows:
        for finding in row.get("findings", []):
            stated.append(finding["probability"])
            there.append(float(finding["effect"] in row["answer"]))
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
    """Share of null takes with a p-value of at most `LIMITS.null_p_level`, which it should equal; None without any."""
    p = [row["p_value"] for row in rows if row["tier"] == "null" and "p_value" in row]
    low = sum(value <= LIMITS.null_p_level for value in p)
    if not p:
        return None
    return NullPValues(n=len(p), level=LIMITS.null_p_level, share=low / len(p), ci95=binomial_ci95(low, len(p)))

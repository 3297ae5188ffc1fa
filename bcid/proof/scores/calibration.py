"""Whether stated probabilities hold: of all that was named with 0.9, nine in ten should be there."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bcid.proof.scores.tiers import exact_ci95

EDGES = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)
SIGNIFICANT = 0.05


@dataclass(frozen=True)
class Calibration:
    """Findings by stated probability, and how many of them were there."""

    n: int
    brier: float | None
    bins: tuple[dict[str, Any], ...]  # low, high, n, stated (mean), there (share), there_ci95


def calibration(rows: Iterable[dict[str, Any]]) -> Calibration:
    """Of all findings of all rows; what was not allowed to be named, or has no name, is there under no name."""
    stated, there = [], []
    for row in rows:
        for finding in row.get("findings", []):
            stated.append(finding["probability"])
            there.append(float(finding["effect"] in row["answer"]))
    p, y = np.array(stated), np.array(there)
    bins = []
    for low, high in itertools.pairwise(EDGES):
        inside = (p > low) & (p <= high) if len(p) else np.zeros(0, dtype=bool)
        if inside.any():
            bins.append({
                "low": low, "high": high, "n": int(inside.sum()), "stated": float(p[inside].mean()),
                "there": float(y[inside].mean()), "there_ci95": exact_ci95(int(y[inside].sum()), int(inside.sum())),
            })  # fmt: skip
    return Calibration(len(p), float(np.mean((p - y) ** 2)) if len(p) else None, tuple(bins))


def of_nothing(rows: Iterable[dict[str, Any]]) -> dict[str, Any] | None:
    """How many takes of nothing have a p-value of SIGNIFICANT or less, a share that it should be; None without any."""
    p = [row["p_value"] for row in rows if row["tier"] == "null" and "p_value" in row]
    low = sum(value <= SIGNIFICANT for value in p)
    return {"n": len(p), "level": SIGNIFICANT, "share": low / len(p), "ci95": exact_ci95(low, len(p))} if p else None

"""Whether stated probabilities hold: of all that was named with 0.9, nine in ten should be there."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

EDGES = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)


@dataclass(frozen=True)
class Calibration:
    """Findings by stated probability, and how many of them were there."""

    n: int
    brier: float | None
    bins: tuple[dict[str, float], ...]  # low, high, n, stated (mean), there (share)


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
                "there": float(y[inside].mean()),
            })  # fmt: skip
    return Calibration(len(p), float(np.mean((p - y) ** 2)) if len(p) else None, tuple(bins))

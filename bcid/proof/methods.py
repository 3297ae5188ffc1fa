"""What the diagnosis and other methods make of the same takes, counted."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from bcid.proof.baselines import NAMING
from bcid.proof.scoring import shown


def summary(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of the diagnosis and each method on the same takes: first names right, false alarms, detections, of how many.

    A take on which the diagnosis ended in an error has nothing of the others, and counts as missed by it.
    """
    by_method: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        others = row.get("others", {})
        if not (others or "error" in row) or not shown(row):  # where naming is wrong
            continue
        first = row["findings"][0]["effect"] if row.get("findings") else None
        ours = {
            "effect": first, "detected": bool(first) or row.get("verdict") == "unknown", "explained": None,
            "seconds": row.get("seconds"), "failed": row.get("error", ""),
        }  # fmt: skip
        for method, said in {"bcid diagnose": ours, **others}.items():
            by_method.setdefault(method, []).append(
                {**said, "answer": row["answer"], "hidden": row["channel"], "tier": row["tier"]}
            )
    return [_counted(method, members) for method, members in by_method.items()]


def _counted(method: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    there, nothing = [r for r in rows if r["answer"]], [r for r in rows if r["tier"] == "null"]
    nameable = [r["effect"] in r["answer"] for r in there if not r["hidden"]]
    explained = [r["explained"] for r in there if r["explained"] is not None]
    seconds = [r["seconds"] for r in rows if r["seconds"] is not None]
    return {
        "method": method, "n": len(rows),
        "top1": [sum(nameable), len(nameable)] if nameable and method in NAMING else None,
        "false": [sum(r["detected"] for r in nothing), len(nothing)] if nothing else None,
        "detected": [sum(r["detected"] for r in there), len(there)] if there else None,
        "explained": float(np.median(explained)) if explained else None,
        "failed": sum(bool(r.get("failed")) for r in rows),
        "seconds": float(np.median(seconds)) if seconds else None,
    }  # fmt: skip

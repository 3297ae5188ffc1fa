"""The diagnosis beside other methods on the same takes of a blind test."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from bcid.documents.prove import MethodScores
from bcid.proof.scores.tiers import shows_effect

NAMING_METHODS = ("bcid diagnose", "SINDy on the residual (pysindy)", "stepwise BIC, base not refitted")
"""Methods that can name an effect; SINDy has terms for 15 of the 42."""


def compare_methods(rows: Iterable[dict[str, Any]]) -> list[MethodScores]:
    """Compare the diagnosis with other methods on the same recordings: right first names, false alarms, detections.

    A row has "answer" (effects there), "findings" and "verdict" of the diagnosis, and "others" (answers of the other
    methods).  Rows without "others", and those whose drive does not show its effect (`shows_effect`), are left out.
    A row with an "error" counts as a miss of the diagnosis.
    """
    by_method: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        others = row.get("others", {})
        if not (others or "error" in row) or not shows_effect(row):  # where naming is wrong
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
    return [_count_method(method, members) for method, members in by_method.items()]


def _count_method(method: str, rows: list[dict[str, Any]]) -> MethodScores:
    """Scores of one method: pairs (hits, recordings) of right names, of false alarms and of detections, and medians.

    A row has the method's "effect", "detected", "explained", "seconds", "failed", and the truth: "answer" (effects
    there), "hidden" (channel of an effect that the method cannot name, else "") and "tier".
    """
    there, nothing = [r for r in rows if r["answer"]], [r for r in rows if r["tier"] == "null"]
    nameable = [r["effect"] in r["answer"] for r in there if not r["hidden"]]
    explained = [r["explained"] for r in there if r["explained"] is not None]
    seconds = [r["seconds"] for r in rows if r["seconds"] is not None]
    return MethodScores(
        method=method, n=len(rows),
        top1=(sum(nameable), len(nameable)) if nameable and method in NAMING_METHODS else None,
        false=(sum(r["detected"] for r in nothing), len(nothing)) if nothing else None,
        detected=(sum(r["detected"] for r in there), len(there)) if there else None,
        explained=float(np.median(explained)) if explained else None,
        failed=sum(bool(r.get("failed")) for r in rows),
        seconds=float(np.median(seconds)) if seconds else None,
    )  # fmt: skip

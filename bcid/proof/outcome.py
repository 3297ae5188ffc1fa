"""A run's outcome as one JSON: the seal, the tiers beside their goals, who was taken for whom, the baselines."""

from __future__ import annotations

import importlib.metadata
import platform
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bcid import __version__
from bcid.proof.calibration import calibration
from bcid.proof.scoring import each_pooled, pooled, right, tiers
from bcid.store.code import code_of

SCHEMA = "bcid.prove/1"
NOTHING, UNKNOWN, ERROR = "nothing", "unknown", "error"
LIBRARIES = ("numpy", "scipy", "numba", "scikit-learn", "pysindy")
REFUTED = 0.01  # of a quick run: right answers as few are rarer, were the goals met


def outcome(rows: Sequence[dict[str, Any]], about: dict[str, Any]) -> dict[str, Any]:
    """All figures of `rows`; `about` holds seed, salt and seal of the run, and whether it is a quick one."""
    return {
        "schema": SCHEMA,
        **about,
        "cases": len(rows),
        "versions": {"bcid": __version__, "python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in LIBRARIES},
        "code": code_of("bcid.diagnosis.diagnose").digest,
        "tiers": [{**asdict(t), "goal": t.goal, "missed": list(t.missed)} for t in tiers(rows)],
        "pooled": pooled(rows),
        "pooled_by_tier": each_pooled(rows),
        "calibration": asdict(calibration(rows)),
        "confusion": confusion(rows),
        "wrong": [wrong(row) for row in rows if not right(row)],
    }


def wrong(row: dict[str, Any]) -> dict[str, Any]:
    """What was concealed in a case that was not answered as it should be, and what was said: enough to look for it."""
    there = ", ".join(row["answer"]) or NOTHING
    if "error" in row:
        return {"case": row["case"], "there": there, "said": row["error"]}
    names = ", ".join(f["effect"] for f in row["findings"])
    place = f" in {row['remainder']['channel']}" if row["verdict"] == "unknown" else ""
    there += f" ({row['channel']})" * bool(row["channel"])
    return {"case": row["case"], "there": there, "said": (names or row["verdict"]) + place}


def missed(found: dict[str, Any]) -> list[str]:
    """The goals that an outcome misses; of a quick one or of a part, in which single figures are chance, all together.

    And every tier, as if any of them had been looked at alone (Bonferroni).
    """
    errors = [f"{t['tier']}: {t['errors']} errors" for t in found["tiers"] if t["errors"]]
    if found.get("quick") or found["cases"] < found.get("of", 0):
        every = found["pooled_by_tier"]
        least = {tier: REFUTED / len(every) for tier in every}
        return errors + [
            f"{tier}: {few['right']} of {few['n']} right where {few['expected']:.1f} are wanted"
            for tier, few in {"all": found["pooled"], **every}.items()
            if few["p"] < least.get(tier, REFUTED)
        ]
    return [*errors, *(f"{t['tier']}: {field}" for t in found["tiers"] for field in t["missed"])]


def confusion(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """How often an effect concealed alone (or nothing) was answered by which first name, nothing, or unknown."""
    counted: dict[str, Counter[str]] = {}
    for row in rows:
        if len(row["answer"]) > 1 or row.get("left_out"):
            continue
        said = ERROR if "error" in row else UNKNOWN if row["verdict"] == "unknown" else NOTHING
        if row.get("findings"):
            said = row["findings"][0]["effect"]
        counted.setdefault(row["answer"][0] if row["answer"] else NOTHING, Counter())[said] += 1
    return {truth: dict(said) for truth, said in counted.items()}

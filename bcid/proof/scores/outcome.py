"""A run's outcome as one JSON: the seal, the tiers beside their goals, who was taken for whom, the baselines."""

from __future__ import annotations

import importlib.metadata
import platform
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bcid import __version__
from bcid.proof.scores.calibration import calibration, of_nothing
from bcid.proof.scores.tiers import each_pooled, pooled, right, tiers

SCHEMA = "bcid.prove/1"
NOTHING, UNKNOWN, ERROR = "nothing", "unknown", "error"
LIBRARIES = ("numpy", "scipy", "numba", "scikit-learn", "pysindy")
REFUTED = 0.01  # of a quick run: right answers as few are rarer, were the goals met


def outcome(rows: Sequence[dict[str, Any]], about: dict[str, Any]) -> dict[str, Any]:
    """All figures of `rows`; `about` holds seed, salt, seal and code of the run, and whether it is a quick one."""
    found = {
        "schema": SCHEMA,
        **about,
        "cases": len(rows),
        "versions": {"bcid": __version__, "python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in LIBRARIES},
        "tiers": [{**asdict(t), "goal": t.goal, "missed": list(t.missed)} for t in tiers(rows)],
        "pooled": pooled(rows),
        "pooled_by_tier": each_pooled(rows),
        "calibration": asdict(calibration(rows)),
        "p_values": of_nothing(rows),
        "confusion": confusion(rows),
        "wrong": [wrong(row) for row in rows if not right(row)],
    }
    return {**found, "missed": missed(found)}


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
    """The goals that an outcome misses, tier by tier where all of a tier's takes have run.

    In a few takes, those of a quick run or of a tier that has not ended, single figures are chance: their right
    answers are judged all together, and every such tier as if any of them had been looked at alone (Bonferroni).
    """
    of = found.get("tiers_of", {})
    ended = [t for t in found["tiers"] if not found.get("quick") and t["n"] >= of.get(t["tier"], 0)]
    few = [t["tier"] for t in found["tiers"] if t not in ended]
    judged = {"all": (found["pooled"], REFUTED)} if few else {}
    judged |= {tier: (found["pooled_by_tier"][tier], REFUTED / len(few)) for tier in few}
    return [
        *(f"{t['tier']}: {t['errors']} errors" for t in found["tiers"] if t["errors"]),
        *(f"{t['tier']}: {field}" for t in ended for field in t["missed"]),
        *(
            f"{tier}: {told['right']} of {told['n']} right where {told['expected']:.1f} are wanted"
            for tier, (told, least) in judged.items()
            if told["p"] < least
        ),
    ]


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

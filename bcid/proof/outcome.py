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
from bcid.proof.scoring import Tier, tiers
from bcid.store.code import code_of

SCHEMA = "bcid.prove/1"
NOTHING, UNKNOWN = "nothing", "unknown"
LIBRARIES = ("numpy", "scipy", "numba", "scikit-learn")


def outcome(rows: Sequence[dict[str, Any]], about: dict[str, Any]) -> dict[str, Any]:
    """All figures of `rows`; `about` holds seed, salt and seal of the run, and whether it is a quick one."""
    return {
        "schema": SCHEMA,
        **about,
        "cases": len(rows),
        "versions": {"bcid": __version__, "python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in LIBRARIES},
        "code": code_of("bcid.diagnosis.diagnose").digest,
        "tiers": [as_json(t, bool(about.get("quick"))) for t in tiers(rows)],
        "calibration": asdict(calibration(rows)),
        "confusion": confusion(rows),
    }


def as_json(tier: Tier, few: bool) -> dict[str, Any]:
    """One tier with its goals and what of them is missed; of few cases, missed by more than chance."""
    return {**asdict(tier), "goal": tier.goal, "missed": list(tier.refuted if few else tier.missed)}


def confusion(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """How often an effect concealed alone (or nothing) was answered by which first name, nothing, or unknown."""
    counted: dict[str, Counter[str]] = {}
    for row in rows:
        if len(row["answer"]) > 1 or row.get("left_out") or "error" in row:
            continue
        said = UNKNOWN if row["verdict"] == "unknown" else NOTHING
        if row["findings"]:
            said = row["findings"][0]["effect"]
        counted.setdefault(row["answer"][0] if row["answer"] else NOTHING, Counter())[said] += 1
    return {truth: dict(said) for truth, said in counted.items()}

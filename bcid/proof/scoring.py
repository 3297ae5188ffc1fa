"""What the rows of a suite amount to, tier by tier."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bcid.effects.table import EFFECTS

SCHEMA = "bcid.prove/1"
LARGEST_SET = 4  # a longer set is a miss
NORMAL95 = 1.96


@dataclass(frozen=True)
class Tier:
    """Shares of a tier's cases; None where a share says nothing there."""

    tier: str
    n: int
    top1: float | None  # what is there stands first
    set: float | None  # or among first, twins and the other findings
    exact: float | None  # the findings are what is there
    false: float | None  # something named where nothing is
    false_ci95: tuple[float, float] | None
    unknown: float  # verdict unknown
    wrong: float | None  # something named that is not there, nor a twin of what is
    set_size: float | None
    parameter_error: float | None  # median, relative
    coverage: float | None  # of 95 % intervals
    oracle_share: float | None  # median, of the held-out gain of the true structure
    kind: float | None  # measurement called measurement
    channel: float | None  # a left-out family's channel
    seconds: float  # median
    errors: int


def tiers(rows: Iterable[dict[str, Any]]) -> list[Tier]:
    """All tiers, in the order of their first cases' names."""
    by_tier: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda r: int(r["case"].rsplit("-", 1)[1])):
        by_tier.setdefault(row["tier"], []).append(row)
    return [_tier(name, members) for name, members in by_tier.items()]


def _tier(name: str, members: Sequence[dict[str, Any]]) -> Tier:
    rows = [r for r in members if "error" not in r]
    known = [r for r in rows if r["answer"] and not r["channel"]]
    nulls = [r for r in rows if not r["answer"]]
    hidden = [r for r in rows if r["channel"]]
    errors, covered = _parameters(known)
    measured = [r for r in known if EFFECTS[r["answer"][0]].kind == "measurement"]
    false = [bool(r["findings"]) for r in nulls]
    return Tier(
        name, len(members), _mean(r["findings"] != [] and r["findings"][0]["effect"] in r["answer"] for r in known),
        _mean(set(r["answer"]) <= _set(r) and len(_first_set(r)) <= LARGEST_SET for r in known),
        _mean(set(r["answer"]) == {f["effect"] for f in r["findings"]} for r in known),
        _mean(false), _interval(sum(false), len(false)) if false else None,
        float(np.mean([r["verdict"] == "unknown" for r in rows])) if rows else 0.0,
        _mean(bool({f["effect"] for f in r["findings"]} - _alike(r)) for r in known + hidden),
        _mean(len(_first_set(r)) for r in known if r["findings"]), _median(errors), _mean(covered),
        _median([r["oracle_share"] for r in known if r.get("oracle_share") is not None]),
        _mean(bool(r["findings"]) and r["findings"][0]["kind"] == "measurement" for r in measured),
        _mean(r["verdict"] == "unknown" and r["remainder"]["channel"] == r["channel"] for r in hidden),
        _median([r["seconds"] for r in rows]) or 0.0, len(members) - len(rows),
    )  # fmt: skip


def _first_set(row: dict[str, Any]) -> set[str]:
    """The first finding and what it cannot be told from."""
    return {row["findings"][0]["effect"], *row["findings"][0]["twins"]} if row["findings"] else set()


def _set(row: dict[str, Any]) -> set[str]:
    return {e for f in row["findings"] for e in (f["effect"], *f["twins"])}


def _alike(row: dict[str, Any]) -> set[str]:
    """What is there, and findings whose twins hold it."""
    answer = set(row["answer"]) if not row["channel"] else set()
    return answer | {f["effect"] for f in row["findings"] if answer & set(f["twins"])}


def _parameters(rows: Sequence[dict[str, Any]]) -> tuple[list[float], list[bool]]:
    """Relative errors of the main parameters, and whether their intervals hold the truth."""
    errors, covered = [], []
    for row in rows:
        for finding in row["findings"]:
            truth = row["truth"].get(finding["effect"], {})
            places = {p.symbol for p in EFFECTS[finding["effect"]].parameters if p.places}
            for symbol, true in truth.items():
                if symbol in places or symbol not in finding["values"] or true == 0.0:
                    continue
                value, se = finding["values"][symbol]
                errors.append(abs(value - true) / abs(true))
                covered.append(abs(value - true) <= NORMAL95 * se)
    return errors, covered


def _interval(hits: int, n: int) -> tuple[float, float]:
    """Exact binomial (Clopper-Pearson)."""
    from scipy.stats import binomtest

    found = binomtest(hits, n).proportion_ci(0.95, method="exact")
    return float(found.low), float(found.high)


def _mean(values: Iterable[Any]) -> float | None:
    listed = list(values)
    return float(np.mean(listed)) if listed else None


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None

"""What the rows of a suite amount to, tier by tier."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bcid.effects.table import EFFECTS
from bcid.proof.scores.localisation import channel_right, channels_of, place_overlap, time_overlap

GOALS: dict[str, dict[str, tuple[float, float]]] = {
    "single": {"right": (0.95, 1.0), "top1": (0.95, 1.0), "set": (0.98, 1.0), "set_size": (0.0, 1.6),
               "parameter_error": (0.0, 0.03), "coverage": (0.85, 0.99), "oracle_share": (0.95, 2.0),
               "kind": (0.95, 1.0), "seconds": (0.0, 60.0), "unshown": (0.0, 0.05), "denied": (0.0, 0.05)},
    "single-imperfect": {"right": (0.85, 1.0), "top1": (0.85, 1.0), "set": (0.95, 1.0), "kind": (0.95, 1.0),
                         "unshown": (0.0, 0.05), "denied": (0.0, 0.05)},
    "null": {"false": (0.0, 0.01)},
    "null-imperfect": {"false": (0.0, 0.05)},
    "left-out": {"right": (0.8, 1.0), "channel": (0.8, 1.0), "wrong": (0.0, 0.1)},
    "pair": {"right": (0.8, 1.0), "exact": (0.8, 1.0)},
    "outside": {"right": (0.8, 1.0), "channel": (0.8, 1.0), "wrong": (0.0, 0.1)},
    "unexcited": {"right": (0.8, 1.0), "not_seen": (0.8, 1.0), "wrong": (0.0, 0.1)},
    "closed-loop": {"right": (0.9, 1.0), "top1": (0.9, 1.0), "wrong": (0.0, 0.1)},
    "two-minutes": {"right": (0.9, 1.0), "top1": (0.9, 1.0), "wrong": (0.0, 0.1)},
    **{tier: {"right": (0.9, 1.0), "wrong": (0.0, 0.1)} for tier in (
        "ten-hertz", "three-times-noise", "half-size", "double-size", "triple", "measurement-and-vehicle",
        "thirty-minutes", "hundred-twenty-hertz",
    )},
}  # fmt: skip
"""Lowest and highest that the project wants of each tier."""

LARGEST_SET = 4  # names for one effect that is there; a longer set is a miss
NORMAL95 = 1.96


@dataclass(frozen=True)
class Tier:
    """Shares of a tier's cases; None where a share says nothing there."""

    tier: str
    n: int
    right: float  # answered as they should be, with nothing wrong beside
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
    coverage_ci95: tuple[float, float] | None
    oracle_share: float | None  # median, of the held-out gain of the true structure
    unshown: float | None  # of what is there and driven: not worth its name even to the truth, and not asked for
    denied: float | None  # of what shows: told as not excited all the same
    more: float | None  # of right names: something is told as left beside them
    kind: float | None  # measurement called measurement
    channel: float | None  # of what has no name: verdict unknown, in the right channel
    located: float | None  # the channel, before any hypothesis
    place_overlap: float | None  # mean, intersection over union
    time_overlap: float | None
    not_seen: float | None  # of what is there and does not show: it is not named, and told as not excited
    seconds: float | None  # median
    errors: int

    @property
    def goal(self) -> dict[str, tuple[float, float]]:
        """What is wanted of it, by field."""
        return GOALS.get(self.tier, {})

    @property
    def missed(self) -> tuple[str, ...]:
        """The fields outside their goals."""
        reached = {field: getattr(self, field) for field in self.goal}  # None: nothing in the tier asks for it
        return tuple(
            f for f, (low, high) in self.goal.items() if reached[f] is not None and not low <= reached[f] <= high
        )


def tiers(rows: Iterable[dict[str, Any]]) -> list[Tier]:
    """All tiers, in the order of their first cases' names."""
    by_tier: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda r: int(r["case"].rsplit("-", 1)[1])):
        by_tier.setdefault(row["tier"], []).append(row)
    return [_tier(name, members) for name, members in by_tier.items()]


def _tier(name: str, members: Sequence[dict[str, Any]]) -> Tier:
    """The shares; a case that ended in an error is a miss, or a false alarm."""
    failed = {"findings": [], "verdict": "error", "remainder": {"channel": ""}, "seconds": float("nan")}
    rows = [r if "error" not in r else {**failed, **r} for r in members]
    known = [r for r in rows if r["answer"] and not r["channel"]]
    seen, unseen = [r for r in known if shown(r)], [r for r in known if not shown(r)]
    nulls = [r for r in rows if not r["answer"]]
    hidden = [r for r in rows if r["channel"]]
    named = [r for r in known if r["findings"] and right(r)]
    errors, covered = _parameters(known)
    measured = [r for r in known if any(EFFECTS[e].kind == "measurement" for e in r["answer"])]
    false = [not right(r) for r in nulls]
    return Tier(
        tier=name,
        n=len(members),
        right=float(np.mean([right(r) for r in rows])),
        top1=_mean(r["findings"] != [] and r["findings"][0]["effect"] in r["answer"] for r in seen),
        set=_mean(_in_the_set(r) for r in seen),
        exact=_mean(set(r["answer"]) == {f["effect"] for f in r["findings"]} for r in seen),
        false=_mean(false),
        false_ci95=exact_ci95(sum(false), len(false)) if false else None,
        unknown=float(np.mean([r["verdict"] == "unknown" for r in rows])),
        wrong=_mean(bool({f["effect"] for f in r["findings"]} - _alike(r)) or "error" in r for r in known + hidden),
        set_size=_mean(len(_set(r)) for r in known if r["findings"]),
        parameter_error=_median(errors),
        coverage=_mean(covered),
        coverage_ci95=exact_ci95(sum(covered), len(covered)) if covered else None,
        oracle_share=_median([r["oracle_share"] for r in known if r.get("oracle_share") is not None]),
        unshown=None if name == "unexcited" else _mean(not shown(r) for r in known),
        denied=_mean(bool(set(r["answer"]) & set(r.get("not_excited", {}))) for r in seen),
        more=_mean(r["remainder"].get("nats", 0.0) > 0.0 for r in named),
        kind=_mean(_called_measurement(r) for r in measured),
        channel=_mean(r["verdict"] == "unknown" and r["remainder"]["channel"] in _channels(r) for r in hidden),
        located=_mean(_known(channel_right, known + hidden)),
        place_overlap=_mean(_known(place_overlap, known)),
        time_overlap=_mean(_known(time_overlap, known)),
        not_seen=_mean(map(_told_unseen, unseen)),
        seconds=_median([r["seconds"] for r in rows if "error" not in r]),
        errors=sum("error" in r for r in members),
    )


def right(row: dict[str, Any]) -> bool:
    """Whether a case was answered as it should be; one that ended in an error was not."""
    if "error" in row:
        return False
    names = {f["effect"] for f in row["findings"]}
    if not row["answer"]:  # flaws of an imperfect base are there, and have no name
        return not names and (row["tier"] != "null" or row["verdict"] != "unknown")
    if row["channel"]:
        return not names and row["verdict"] == "unknown" and row["remainder"]["channel"] in _channels(row)
    if not shown(row):
        return not names and _told_unseen(row)
    return bool(names) and _in_the_set(row) and not names - _alike(row)


def shown(row: Mapping[str, Any]) -> bool:
    """Whether a recording shows its effect: by the driver, or by what even the true structure is worth on it.

    A driver whose tyres never slide does not show that a patch is slippery.
    """
    return row["tier"] != "unexcited" and row.get("shown") is not False


def _told_unseen(row: dict[str, Any]) -> bool:
    """Whether what a drive does not excite is not named, and told as not excited."""
    answer = set(row["answer"])
    return not _set(row) & answer and answer <= set(row.get("not_excited", {}))


def pooled(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Right answers of a few cases of many tiers together, and how rarely there were as few, were all goals just met.

    The number right is a sum of independent draws with the tiers' own rates (Poisson-binomial).
    """
    rates = [_wanted(row["tier"]) for row in rows]
    chances = np.ones(1)
    for rate in rates:
        chances = np.convolve(chances, [1.0 - rate, rate])
    hits = sum(map(right, rows))
    return {"right": hits, "n": len(rows), "expected": float(sum(rates)), "p": float(chances[: hits + 1].sum())}


def _wanted(tier: str) -> float:
    """Share of right answers that is wanted of a tier; where nothing is there, those are without a false alarm."""
    goal = GOALS[tier]
    return goal["right"][0] if "right" in goal else 1.0 - goal["false"][1]


def each_pooled(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """The same of each tier alone: one that is broken altogether hides among the others."""
    return {tier: pooled([r for r in rows if r["tier"] == tier]) for tier in dict.fromkeys(r["tier"] for r in rows)}


def _channels(row: dict[str, Any]) -> tuple[str, ...]:
    """In which a left-out effect acts."""
    return (*channels_of(row["answer"][0], row["channel"]), row["channel"])


def _called_measurement(row: dict[str, Any]) -> bool:
    """Whether as much is called measurement as there is, and nothing beyond what is there is called vehicle."""
    found = {f["effect"]: f["kind"] for f in row["findings"]}
    there = [e for e in row["answer"] if EFFECTS[e].kind == "measurement"]
    called = [e for e, kind in found.items() if kind == "measurement"]
    return len(called) >= len(there) and all(e in row["answer"] for e in found if e not in called)


def _set(row: dict[str, Any]) -> set[str]:
    """What is returned: all findings and what they cannot be told from.  A pair that is a twin counts as one."""
    return {e for f in row["findings"] for e in (f["effect"], *f["twins"])}


def _in_the_set(row: dict[str, Any]) -> bool:
    """Whether all that is there is returned, in a set that is no longer than tells something."""
    return set(row["answer"]) <= _set(row) and len(_set(row)) < LARGEST_SET + len(row["answer"])


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
            places = {p.symbol for p in EFFECTS[finding["effect"]].places}
            for symbol, true in truth.items():
                if symbol in places or symbol not in finding["values"] or true == 0.0:
                    continue
                value, se = finding["values"][symbol]
                errors.append(abs(value - true) / abs(true))
                covered.append(abs(value - true) <= NORMAL95 * se)
    return errors, covered


def exact_ci95(hits: int, n: int) -> tuple[float, float]:
    """Of a share, exact binomial (Clopper-Pearson)."""
    from scipy.stats import binomtest

    found = binomtest(hits, n).proportion_ci(0.95, method="exact")
    return float(found.low), float(found.high)


def _known(of: Callable[[dict[str, Any]], float | None], rows: Iterable[dict[str, Any]]) -> Iterable[float]:
    """What there is to say of each row; nothing of those of which there is nothing."""
    return (value for value in map(of, rows) if value is not None)


def _mean(values: Iterable[Any]) -> float | None:
    listed = list(values)
    return float(np.mean(listed)) if listed else None


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None

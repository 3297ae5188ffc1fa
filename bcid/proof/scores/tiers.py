"""Scores of a blind test's rows, tier by tier."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bcid.documents.prove import RightAnswers, TierScores
from bcid.effects.table import EFFECTS
from bcid.proof.limits import GOALS, LIMITS
from bcid.proof.scores.localisation import effect_channels, is_channel_right, place_overlap, time_overlap

NORMAL_QUANTILE_975 = 1.96


def score_tiers(rows: Iterable[dict[str, Any]]) -> list[TierScores]:
    """Score a blind test's rows tier by tier, in the order of the cases' numbers."""
    by_tier: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda r: int(r["case"].rsplit("-", 1)[1])):
        by_tier.setdefault(row["tier"], []).append(row)
    return [_add_goals(_score_tier(name, members)) for name, members in by_tier.items()]


def _add_goals(scores: TierScores) -> TierScores:
    """The scores of a tier with its goals, and the names of those outside them; a score that is None misses none."""
    goal = GOALS.get(scores.tier, {})
    reached = {name: scores.score(name) for name in goal}
    missed = [n for n, (low, high) in goal.items() if (value := reached[n]) is not None and not low <= value <= high]
    return scores.model_copy(update={"goal": goal, "missed": tuple(missed)})


def _score_tier(name: str, members: Sequence[dict[str, Any]]) -> TierScores:
    """Score the rows of one tier; an error counts as a miss, or as a false alarm where nothing is there."""
    failed = {"findings": [], "verdict": "error", "remainder": {"channel": ""}, "seconds": float("nan")}
    rows = [r if "error" not in r else {**failed, **r} for r in members]
    known = [r for r in rows if r["answer"] and not r["channel"]]
    seen, unseen = [r for r in known if shows_effect(r)], [r for r in known if not shows_effect(r)]
    nulls = [r for r in rows if not r["answer"]]
    hidden = [r for r in rows if r["channel"]]
    named = [r for r in known if r["findings"] and is_right(r)]
    errors, covered = _parameter_errors(known)
    measured = [r for r in known if any(EFFECTS[e].kind == "measurement" for e in r["answer"])]
    false = [not is_right(r) for r in nulls]
    return TierScores(
        tier=name,
        n=len(members),
        right=float(np.mean([is_right(r) for r in rows])),
        top1=_average(r["findings"] != [] and r["findings"][0]["effect"] in r["answer"] for r in seen),
        set=_average(_is_in_short_set(r) for r in seen),
        exact=_average(set(r["answer"]) == {f["effect"] for f in r["findings"]} for r in seen),
        false=_average(false),
        false_ci95=binomial_ci95(sum(false), len(false)) if false else None,
        unknown=float(np.mean([r["verdict"] == "unknown" for r in rows])),
        wrong=_average(
            bool({f["effect"] for f in r["findings"]} - _excusable_names(r)) or "error" in r for r in known + hidden
        ),
        set_size=_average(len(_names_and_twins(r)) for r in known if r["findings"]),
        parameter_error=_average(errors, np.median),
        coverage=_average(covered),
        coverage_ci95=binomial_ci95(sum(covered), len(covered)) if covered else None,
        oracle_share=_average([r["oracle_share"] for r in known if r.get("oracle_share") is not None], np.median),
        unshown=None if name == "unexcited" else _average(not shows_effect(r) for r in known),
        denied=_average(bool(set(r["answer"]) & set(r.get("not_excited", {}))) for r in seen),
        more=_average(r["remainder"].get("nats", 0.0) > 0.0 for r in named),
        kind=_average(_are_kinds_right(r) for r in measured),
        channel=_average(
            r["verdict"] == "unknown" and r["remainder"]["channel"] in _accepted_channels(r) for r in hidden
        ),
        located=_average(_defined_scores(is_channel_right, known + hidden)),
        place_overlap=_average(_defined_scores(place_overlap, known)),
        time_overlap=_average(_defined_scores(time_overlap, known)),
        not_seen=_average(map(_is_reported_unexcited, unseen)),
        seconds=_average([r["seconds"] for r in rows if "error" not in r], np.median),
        errors=sum("error" in r for r in members),
    )


def is_right(row: dict[str, Any]) -> bool:
    """Whether a blind test's row (a case and what was said of its take) is a right answer; one with an error is not.

    Right is to name what is there, or what cannot be told from it, and nothing else; to name nothing where nothing is
    there; to say "unknown" in the right channel of what may not be named; to report what does not show as not excited.
    """
    if "error" in row:
        return False
    names = {f["effect"] for f in row["findings"]}
    if not row["answer"]:  # flaws of an imperfect base are there, and have no name
        return not names and (row["tier"] != "null" or row["verdict"] != "unknown")
    if row["channel"]:
        return not names and row["verdict"] == "unknown" and row["remainder"]["channel"] in _accepted_channels(row)
    if not shows_effect(row):
        return not names and _is_reported_unexcited(row)
    return bool(names) and _is_in_short_set(row) and not names - _excusable_names(row)


def shows_effect(row: Mapping[str, Any]) -> bool:
    """Whether the take of a blind test's row shows its effect: not if the driver avoids it or the truth gains nothing.

    A driver whose tyres never slide does not show that a patch is slippery.
    """
    return row["tier"] != "unexcited" and row.get("shown") is not False


def _is_reported_unexcited(row: dict[str, Any]) -> bool:
    """Whether a blind test's row reports all effects that are there as not excited, and names none of them."""
    answer = set(row["answer"])
    return not _names_and_twins(row) & answer and answer <= set(row.get("not_excited", {}))


def pool_right_answers(rows: Sequence[dict[str, Any]]) -> RightAnswers:
    """Count right answers over many tiers, and the probability "p" of as few if all goals were just met.

    The number of right answers is then a sum of independent draws with the tiers' wanted rates (Poisson-binomial).
    """
    rates = [_wanted_rate(row["tier"]) for row in rows]
    chances = np.ones(1)
    for rate in rates:
        chances = np.convolve(chances, [1.0 - rate, rate])
    hits = sum(map(is_right, rows))
    return RightAnswers(right=hits, n=len(rows), expected=float(sum(rates)), p=float(chances[: hits + 1].sum()))


def _wanted_rate(tier: str) -> float:
    """Share of right answers that is wanted of a tier: its goal, or one minus the false alarms it may have."""
    goal = GOALS[tier]
    return goal["right"][0] if "right" in goal else 1.0 - goal["false"][1]


def pool_each_tier(rows: Sequence[dict[str, Any]]) -> dict[str, RightAnswers]:
    """Right answers of each tier by itself, counted as by `pool_right_answers`: a bad tier would hide among others."""
    return {
        tier: pool_right_answers([r for r in rows if r["tier"] == tier])
        for tier in dict.fromkeys(r["tier"] for r in rows)
    }


def _accepted_channels(row: dict[str, Any]) -> tuple[str, ...]:
    """Channels that count as right for a row's left-out or unknown effect."""
    return (*effect_channels(row["answer"][0], row["channel"]), row["channel"])


def _are_kinds_right(row: dict[str, Any]) -> bool:
    """Whether a row names as many measurement effects as are there, and no wrong effect of another kind."""
    found = {f["effect"]: f["kind"] for f in row["findings"]}
    there = [e for e in row["answer"] if EFFECTS[e].kind == "measurement"]
    called = [e for e, kind in found.items() if kind == "measurement"]
    return len(called) >= len(there) and all(e in row["answer"] for e in found if e not in called)


def _names_and_twins(row: dict[str, Any]) -> set[str]:
    """All effects in a row's findings: names, and twins that cannot be told from them; a joint "a+b" counts as one."""
    return {e for f in row["findings"] for e in (f["effect"], *f["twins"])}


def _is_in_short_set(row: dict[str, Any]) -> bool:
    """Whether a row's findings and their twins include all concealed effects, and are few enough to be informative."""
    return set(row["answer"]) <= _names_and_twins(row) and len(
        _names_and_twins(row)
    ) < LIMITS.max_names_per_effect + len(row["answer"])


def _excusable_names(row: dict[str, Any]) -> set[str]:
    """Names in a row that are not wrong: effects that are there, and findings whose twins are there."""
    answer = set(row["answer"]) if not row["channel"] else set()
    return answer | {f["effect"] for f in row["findings"] if answer & set(f["twins"])}


def _parameter_errors(rows: Sequence[dict[str, Any]]) -> tuple[list[float], list[bool]]:
    """Relative errors of found parameters other than places, and whether their 95 % intervals hold the truth."""
    errors, covered = [], []
    for row in rows:
        for finding in row["findings"]:
            truth = row["truth"].get(finding["effect"], {})
            places = {p.symbol for p in EFFECTS[finding["effect"]].place_parameters}
            for symbol, true in truth.items():
                if symbol in places or symbol not in finding["values"] or true == 0.0:
                    continue
                value, se = finding["values"][symbol]
                errors.append(abs(value - true) / abs(true))
                covered.append(abs(value - true) <= NORMAL_QUANTILE_975 * se)
    return errors, covered


def binomial_ci95(hits: int, n: int) -> tuple[float, float]:
    """Exact 95 % interval (Clopper-Pearson) of a share, from `hits` of `n`."""
    from scipy.stats import binomtest

    found = binomtest(hits, n).proportion_ci(0.95, method="exact")
    return float(found.low), float(found.high)


def _defined_scores(score: Callable[[dict[str, Any]], float | None], rows: Iterable[dict[str, Any]]) -> Iterable[float]:
    """Scores of the rows for which `score` is not None."""
    return (value for value in map(score, rows) if value is not None)


def _average(values: Iterable[Any], average: Callable[[list[Any]], Any] = np.mean) -> float | None:
    """Mean of the values, or another average; None without values."""
    listed = list(values)
    return float(average(listed)) if listed else None

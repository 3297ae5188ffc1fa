"""Scores of a blind test's rows, tier by tier."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bcid.documents.prove import RightAnswers, TierScores
from bcid.effects.table import EFFECTS
from bcid.proof.limits import GOALS, LIMITS
from bcid.proof.scores.localisation import effect_channels, is_channel_right, place_overlap, time_overlap

NORMAL_QUANTILE_975 = 1.96
NOTHING_THERE = ("null", "small-null", "other-day")
"""Tiers whose car follows the base model's laws, so that there is nothing unknown."""


def score_tiers(rows: Iterable[dict[str, Any]]) -> list[TierScores]:
    """Score the results (rows) of a blind test by "tier" (kind of case), in the order of case numbers."""
    by_tier: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda r: int(r["case"].rsplit("-", 1)[1])):
        by_tier.setdefault(row["tier"], []).append(row)
    return [_add_goals(_score_tier(name, members)) for name, members in by_tier.items()]


def _add_goals(scores: TierScores) -> TierScores:
    """Add to a tier's scores their goals, (lowest, highest) by name from GOALS, and the names of scores outside them.

    A score that is None, as no case of the tier (kind of blind case) defines it, misses no goal.
    """
    goal = GOALS.get(scores.tier, {})
    reached = {name: scores.score(name) for name in goal}
    missed = [n for n, (low, high) in goal.items() if (value := reached[n]) is not None and not low <= value <= high]
    return scores.model_copy(update={"goal": goal, "missed": tuple(missed)})


def _score_tier(name: str, members: Sequence[dict[str, Any]]) -> TierScores:
    """Score the results (rows) of one tier (kind of blind case): shares of right, wrong and located answers and others.

    A row with an "error" counts as a miss, or as a false alarm where nothing is concealed ("answer" is empty).
    """
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
        false_figures=_average(len(_false_figures(r)) for r in rows if r.get("other_parameters") and "error" not in r),
        seconds=_average([r["seconds"] for r in rows if "error" not in r], np.median),
        errors=sum("error" in r for r in members),
    )


def is_right(row: dict[str, Any]) -> bool:
    """Whether the diagnosis of a blind case (a simulated drive with concealed effects) is right, by its stored row.

    Reads "answer" (effects there), "channel" (of an effect without a name), "findings", "verdict", "remainder" and
    "not_excited".  Right is: only what is there is named, or effects that cannot be told from it; nothing is named
    where nothing is there; "unknown" in the right channel, where the effect has no name or was excluded; reported as
    not excited, where the drive does not show the effect.  An effect may be named that is there besides ("also").  A
    row with an "error" is wrong.
    """
    if "error" in row:
        return False
    names = {f["effect"] for f in row["findings"]}
    if not row["answer"]:  # flaws of an imperfect base, and laws of other formulas, are there and have no name
        false_names = names - _excusable_names(row)
        return not false_names and (row["tier"] not in NOTHING_THERE or row["verdict"] != "unknown")
    if row["channel"]:
        return not names and row["verdict"] == "unknown" and row["remainder"]["channel"] in _accepted_channels(row)
    if not shows_effect(row):
        return not names and _is_reported_unexcited(row)
    return bool(names) and _is_in_short_set(row) and not names - _excusable_names(row)


def _false_figures(row: Mapping[str, Any]) -> set[str]:
    """Figures of which a row says that they are others than published ("other_figures"), and which are not.

    A figure is the symbol of a parameter, or that of an effect's, `effect__symbol`; those that are others are in
    "other_parameters", effects in "also".
    """
    others = {*row["other_parameters"], *row.get("also", ())}
    told = {f["symbol"] for f in row.get("other_figures", ())}
    return {symbol for symbol in told if symbol.partition("__")[0] not in others}


def shows_effect(row: Mapping[str, Any]) -> bool:
    """Whether the drive of a blind case shows its effect: with the true effect, a refit gains more than chance does.

    The gain is in held-out log-likelihood.  False if the row's "shown" is False, or in the tier "unexcited", whose
    drives are slow circles that do not excite the effect; True otherwise.
    """
    return row["tier"] != "unexcited" and row.get("shown") is not False


def _is_reported_unexcited(row: dict[str, Any]) -> bool:
    """Whether a row reports all effects there ("answer") as "not_excited" and names none of them.

    Names are findings and their twins, effects that the recording cannot tell from them.
    """
    answer = set(row["answer"])
    return not _names_and_twins(row) & answer and answer <= set(row.get("not_excited", {}))


def pool_right_answers(rows: Sequence[dict[str, Any]]) -> RightAnswers:
    """Count the right answers of rows of any tiers, with the p-value of a one-sided binomial test against the goals.

    "p" is the probability of as many right answers or fewer if each is right with the goal of its tier (kind of blind
    case), independently: a Poisson binomial distribution.
    """
    rates = [_wanted_rate(row["tier"]) for row in rows]
    chances = np.ones(1)
    for rate in rates:
        chances = np.convolve(chances, [1.0 - rate, rate])
    hits = sum(map(is_right, rows))
    return RightAnswers(right=hits, n=len(rows), expected=float(sum(rates)), p=float(chances[: hits + 1].sum()))


def _wanted_rate(tier: str) -> float:
    """Lowest share of right answers wanted of a tier (kind of blind case), by GOALS.

    For tiers without a goal of right answers it is 1 - the share of false alarms allowed.
    """
    goal = GOALS[tier]
    return goal["right"][0] if "right" in goal else 1.0 - goal["false"][1]


def pool_each_tier(rows: Sequence[dict[str, Any]]) -> dict[str, RightAnswers]:
    """Right answers of each tier (kind of blind case), with the p-value of a binomial test against the tier's goal."""
    return {
        tier: pool_right_answers([r for r in rows if r["tier"] == tier])
        for tier in dict.fromkeys(r["tier"] for r in rows)
    }


def _accepted_channels(row: dict[str, Any]) -> tuple[str, ...]:
    """Channels ("fx", "motor" ...) that are right for the effect in a row's "answer", which the diagnosis cannot name.

    They are those in which the effect acts, and the row's own "channel".
    """
    return (*effect_channels(row["answer"][0], row["channel"]), row["channel"])


def _are_kinds_right(row: dict[str, Any]) -> bool:
    """Whether a row names as many effects of the measurement as are there, whichever, and no false ones of other kinds.

    Reads "findings" and "answer" (the effects there).  Kinds are measurement, vehicle and environment; more effects
    of the measurement than are there are no fault here.
    """
    found = {f["effect"]: f["kind"] for f in row["findings"]}
    there = [e for e in row["answer"] if EFFECTS[e].kind == "measurement"]
    called = [e for e, kind in found.items() if kind == "measurement"]
    return len(called) >= len(there) and all(e in row["answer"] for e in found if e not in called)


def _names_and_twins(row: dict[str, Any]) -> set[str]:
    """All effects in a row's "findings", and their "twins" (effects that its recording cannot tell from them).

    A joint name "a+b" counts as one.
    """
    return {e for f in row["findings"] for e in (f["effect"], *f["twins"])}


def _is_in_short_set(row: dict[str, Any]) -> bool:
    """Whether all effects there ("answer") are among a row's findings and their twins, and these are few.

    Twins are effects that the recording cannot tell apart; few is fewer than `LIMITS.max_names_per_effect` plus the
    number of effects there.  Effects in "also", which are there besides, do not count.
    """
    said, there = _names_and_twins(row), set(row["answer"])
    return there <= said and len(said - set(row.get("also", ()))) < LIMITS.max_names_per_effect + len(there)


def _excusable_names(row: dict[str, Any]) -> set[str]:
    """Effects that a row may name without being wrong: those there, and findings that have one of them as a "twin".

    There are those in "answer" and, beside them, in "also".  Twins are effects that the recording cannot tell apart.
    The set is empty where the row has a "channel": its effect has no name or was excluded from the diagnosis.
    """
    answer = {*row["answer"], *row.get("also", ())} if not row["channel"] else set()
    return answer | {f["effect"] for f in row["findings"] if answer & set(f["twins"])}


def _parameter_errors(rows: Sequence[dict[str, Any]]) -> tuple[list[float], list[bool]]:
    """Relative errors |fitted - true| / |true| of parameters, and whether their 95 % intervals contain the true values.

    Fitted values are in "findings", true ones in "truth", the concealed effects' parameters; places, times and true
    values of 0 are left out.
    """
    errors, covered = [], []
    for row in rows:
        for finding in row["findings"]:
            if not (truth := row["truth"].get(finding["effect"], {})):
                continue
            places = {p.symbol for p in EFFECTS[finding["effect"]].place_parameters}
            for symbol, true in truth.items():
                if symbol in places or symbol not in finding["values"] or true == 0.0:
                    continue
                value, se = finding["values"][symbol]
                errors.append(abs(value - true) / abs(true))
                covered.append(abs(value - true) <= NORMAL_QUANTILE_975 * se)
    return errors, covered


def binomial_ci95(hits: int, n: int) -> tuple[float, float]:
    """Exact 95 % confidence interval (Clopper-Pearson) of a probability, from `hits` in `n` trials."""
    from scipy.stats import binomtest

    found = binomtest(hits, n).proportion_ci(0.95, method="exact")
    return float(found.low), float(found.high)


def _defined_scores(score: Callable[[dict[str, Any]], float | None], rows: Iterable[dict[str, Any]]) -> Iterable[float]:
    """The values of `score(row)` for all rows where it is not None."""
    return (value for value in map(score, rows) if value is not None)


def _average(values: Iterable[Any], average: Callable[[list[Any]], Any] = np.mean) -> float | None:
    """Mean of the values, or another `average` of them such as the median; None if there are none."""
    listed = list(values)
    return float(average(listed)) if listed else None

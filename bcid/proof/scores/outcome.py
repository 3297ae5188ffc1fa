"""The outcome of a blind test (prove.json): tiers beside their goals, calibration, confusions and wrong answers."""

import importlib.metadata
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from bcid import __version__
from bcid.documents.prove import ProveDocument, WrongAnswer
from bcid.proof.limits import LIMITS
from bcid.proof.scores.calibration import calibration, null_p_values
from bcid.proof.scores.compare_methods import compare_methods
from bcid.proof.scores.tiers import is_right, pool_each_tier, pool_right_answers, score_tiers

NOTHING, UNKNOWN, ERROR = "nothing", "unknown", "error"
LIBRARIES = ("numpy", "scipy", "numba", "scikit-learn", "pysindy")


def blind_outcome(rows: Sequence[dict[str, Any]], about: Mapping[str, Any]) -> ProveDocument:
    """The document prove.json of a blind test: scores by tier (kind of case), calibration, wrong answers, missed goals.

    `rows` are the results of all cases that have run; the fields in `about` (seed, salt, seal, code ...) are copied.
    """
    document = ProveDocument(
        **about,
        cases=len(rows),
        versions={
            "bcid": __version__, "python": platform.python_version(),
            **{name: importlib.metadata.version(name) for name in LIBRARIES},
        },
        tiers=tuple(score_tiers(rows)),
        pooled=pool_right_answers(rows),
        pooled_by_tier=pool_each_tier(rows),
        calibration=calibration(rows),
        p_values=null_p_values(rows),
        confusion=count_confusions(rows),
        wrong=tuple(describe_wrong_answer(row) for row in rows if not is_right(row)),
        baselines=tuple(compare_methods(rows)),
    )  # fmt: skip
    return document.model_copy(update={"missed": tuple(missed_goals(document))})


def describe_wrong_answer(row: dict[str, Any]) -> WrongAnswer:
    """Describe a wrongly answered blind case: its name, the effects there, and what the diagnosis said instead.

    Reads "case", "answer" (effects there), "channel" (of an effect without a name), "findings", "verdict" and
    "remainder" (what stays unexplained), or "error".
    """
    there = ", ".join(row["answer"]) or NOTHING
    if "error" in row:
        return WrongAnswer(case=row["case"], there=there, said=row["error"])
    names = ", ".join(f["effect"] for f in row["findings"])
    place = f" in {row['remainder']['channel']}" if row["verdict"] == "unknown" else ""
    there += f" ({row['channel']})" * bool(row["channel"])
    return WrongAnswer(case=row["case"], there=there, said=(names or row["verdict"]) + place)


def missed_goals(document: ProveDocument) -> list[str]:
    """Sentences on the goals that a blind test misses, and on errors; empty if none.

    A complete tier (kind of case) misses each score outside its goal.  Incomplete tiers, and all of a quick run, are
    too small for that: a binomial test of right answers against the goals is made of all rows together at the level
    `LIMITS.refuting_p`, and of each such tier at this level divided by their number (Bonferroni).
    """
    sizes = document.tiers_of
    ended = [t for t in document.tiers if not document.quick and t.n >= sizes.get(t.tier, 0)]
    few = [t.tier for t in document.tiers if t not in ended]
    judged = {"all": (document.pooled, LIMITS.refuting_p)} if few else {}
    judged |= {tier: (document.pooled_by_tier[tier], LIMITS.refuting_p / len(few)) for tier in few}
    return [
        *(f"{t.tier}: {t.errors} errors" for t in document.tiers if t.errors),
        *(f"{t.tier}: {field}" for t in ended for field in t.missed),
        *(
            f"{tier}: {pool.right} of {pool.n} right where {pool.expected:.1f} are wanted"
            for tier, (pool, level) in judged.items()
            if pool.p < level
        ),
    ]


def count_confusions(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Confusion matrix of effects there and effects named, as {effect there: {effect named first: number of rows}}.

    In place of a name there is "unknown" (the verdict), "nothing" or "error".  Rows that conceal several effects are
    left out, and rows with "left_out" (the concealed effect was excluded from the diagnosis, so "unknown" is right).
    """
    counted: dict[str, Counter[str]] = {}
    for row in rows:
        if len(row["answer"]) > 1 or row.get("left_out"):
            continue
        said = ERROR if "error" in row else UNKNOWN if row["verdict"] == "unknown" else NOTHING
        if named := row.get("findings"):
            said = named[0]["effect"]
        counted.setdefault(row["answer"][0] if row["answer"] else NOTHING, Counter())[said] += 1
    return {truth: dict(said) for truth, said in counted.items()}

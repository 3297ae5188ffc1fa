"""Scores of the answers to questions about real recordings; rows outlive a change of what is accepted.

A scored row adds "right", "beside" (names that were not asked for) and, where something is withheld, "first" (whether
an accepted name stands first).
"""

import math
from collections.abc import Mapping, Sequence, Set
from typing import Any

from bcid.effects.table import EFFECTS
from bcid.proof.limits import LIMITS
from bcid.proof.real.questions import ANY_VEHICLE_EFFECT, NOT_ASKED, EditedQuestion, WithheldQuestion

SCHEMA = "bcid.prove-real/1"
REAL_TIERS = ("withheld", "control", "edited")


def score_answer(question: WithheldQuestion | EditedQuestion, row: Mapping[str, Any]) -> dict[str, Any]:
    """Score one answer about a real recording: a copy of its row with "right", true or false, and further scores.

    A row with an "error" is wrong.  The verdict NOT_ASKED is right: the simulation predicts as well without what is
    withheld, so there was nothing to find.
    """
    if "error" in row:
        return {**row, "right": False}
    if row["verdict"] == NOT_ASKED:
        return {**row, "right": True}
    return _score_edited(question, row) if isinstance(question, EditedQuestion) else _score_withheld(question, row)


def _score_withheld(question: WithheldQuestion, row: Mapping[str, Any]) -> dict[str, Any]:
    """Score the row of a question that withholds something from the simulation: has the diagnosis named it?

    Right is an accepted effect among the findings and their twins (effects that cannot be told from them), if these
    are fewer than `LIMITS.max_names_per_effect` plus the findings; or "unknown in CHANNEL", if accepted.  In a
    control, where nothing should be named, an `accepted` name is wrong unless it is also `known`.  Adds "right",
    "first" (the first finding is accepted) and "beside" (findings that are not).
    """
    sets = [{f["effect"], *f["twins"]} for f in row["findings"]]
    few = len(set().union(*sets)) < LIMITS.max_names_per_effect + max(len(sets), 1)
    met = [few and _is_any_accepted(names, question.accepted) for names in sets]
    beside = [f["effect"] for f, is_met in zip(row["findings"], met, strict=True) if not is_met]
    if question.control:
        names = _split_joint_names(set().union(*sets, _unknown_label(row)))
        right = not _add_vehicle_kind(names - set(question.known)) & set(question.accepted)
    else:
        right = any(met) or _is_any_accepted(_unknown_label(row), question.accepted)
    return {**row, "first": right and (not met or met[0]), "beside": beside, "right": right}


def _score_edited(question: EditedQuestion, row: Mapping[str, Any]) -> dict[str, Any]:
    """Score the row of a recording that was edited to show an effect of known size: is it found, at that size?

    Right is to name this effect alone, with its first parameter raised over its value "before" the edit by the edit's
    size, and its other parameters unchanged, within the tolerance of `_is_near`.  Adds "right", "value" (of the first
    parameter) and "beside" (other names).
    """
    values = next((f["values"] for f in row["findings"] if f["effect"] == question.effect), None)
    beside = [f["effect"] for f in row["findings"] if f["effect"] != question.effect]
    first, *others = row["before"]
    true = {first: question.value, **dict.fromkeys(others, 0.0)}
    size = abs(question.value)
    right = values is not None and all(_is_near(values[s], row["before"][s], true[s], size) for s in true)
    return {**row, "value": values[first][0] if values else None, "beside": beside, "right": right and not beside}


def _is_near(value: Sequence[float], before: Sequence[float], edit: float, size: float) -> bool:
    """Whether a parameter changed from `before` to `value`, both (value, standard error), by about `edit`.

    The tolerance of |value - before - edit| is the larger of `LIMITS.edit_error_share` times `size` and
    `LIMITS.edit_error_se` times the standard error of value - before, but at most `LIMITS.max_edit_error_share` times
    `size`.  `size` is the magnitude of the edit, also where this parameter should not change (`edit` is 0).
    """
    off, se = value[0] - before[0] - edit, math.hypot(value[1], before[1])
    near = max(LIMITS.edit_error_share * size, LIMITS.edit_error_se * se)
    return abs(off) < min(near, LIMITS.max_edit_error_share * size)


def _is_any_accepted(names: Set[str], accepted: Sequence[str]) -> bool:
    """Whether any of the `names` is in `accepted`; a joint name "a+b" of two similar effects needs both a and b."""
    return any(set(name.split("+")) <= set(accepted) for name in names)


def _unknown_label(answer: Mapping[str, Any]) -> set[str]:
    """{"unknown in CHANNEL"} if the answer's "verdict" is "unknown", else the empty set.

    CHANNEL, such as "fx", is where the remaining mismatch enters ("remainder").
    """
    return {f"unknown in {answer['remainder']['channel']}"} if answer["verdict"] == "unknown" else set()


def _split_joint_names(names: Set[str]) -> set[str]:
    """The effects in `names`, with each joint name "a+b" of two effects that act alike split into its parts."""
    return {part for name in names for part in name.split("+")}


def _add_vehicle_kind(names: Set[str]) -> set[str]:
    """Add ANY_VEHICLE_EFFECT ("vehicle") to the `names` if one of them is an effect of the vehicle, by its kind.

    The other kinds are measurement and environment.
    """
    return {*names, *(EFFECTS[e].kind for e in names if e in EFFECTS and EFFECTS[e].kind == ANY_VEHICLE_EFFECT)}


def real_outcome(rows: Sequence[Mapping[str, Any]], code: str) -> dict[str, Any]:
    """The document real.json: scored rows of all questions about real recordings, and numbers of right answers by tier.

    Tiers are "withheld" (something is taken from the simulation), "control" (nothing is to be named) and "edited" (an
    effect is made in the recording).  For "withheld" there are also the numbers of right answers by a name, of those
    whose name comes first or alone, of all names, and of accepted names.  Rows with the verdict NOT_ASKED are not
    counted.  `code` is the digest of the code that made the rows.
    """
    rows = sorted(rows, key=lambda r: (REAL_TIERS.index(r["tier"]), r["recording"], r["case"]))
    counted = [r for r in rows if r["verdict"] != NOT_ASKED]
    tiers = {
        tier: {"right": sum(r["right"] for r in members), "n": len(members)}
        for tier in dict.fromkeys(r["tier"] for r in rows)
        for members in [[r for r in counted if r["tier"] == tier]]
    }
    if "withheld" in tiers:
        asked = [r for r in counted if r["tier"] == "withheld" and "error" not in r]
        named = [r for r in asked if r["right"] and r["findings"]]
        names = sum(len(r["findings"]) for r in asked)
        tiers["withheld"] |= {
            "named": len(named), "first": sum(r["first"] for r in named), "alone": sum(not r["beside"] for r in named),
            "names": names, "accepted": names - sum(len(r["beside"]) for r in asked),
        }  # fmt: skip
    return {"schema": SCHEMA, "code": code, "tiers": tiers, "rows": rows}

"""Whether what was said of a real recording is right, by what its question accepts; a row outlives a change of either.

`beside` are the names that are none of what was asked for, `first` whether what was asked for stands first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from typing import Any

from bcid.effects.table import EFFECTS
from bcid.proof.real.questions import NOT_ASKED, VEHICLE, Edited, Withheld
from bcid.proof.scores.tiers import LARGEST_SET

NEAR, SURE = 0.25, 3.0  # of an edit's size, or standard errors, within which its value must be found,
FARTHEST = 0.5  # of its size, however large they are


def judged(case: Withheld | Edited, row: Mapping[str, Any]) -> dict[str, Any]:
    """The row with what of its answer is right."""
    if "error" in row:
        return {**row, "right": False}
    if row["verdict"] == NOT_ASKED:
        return {**row, "right": True}
    return _edited(case, row) if isinstance(case, Edited) else _withheld(case, row)


def _withheld(case: Withheld, row: Mapping[str, Any]) -> dict[str, Any]:
    """An accepted name, of no more names for one effect than tell something; of a control, none of them."""
    sets = [{f["effect"], *f["twins"]} for f in row["findings"]]
    few = len(set().union(*sets)) < LARGEST_SET + max(len(sets), 1)
    met = [few and _accepted(names, case.accepted) for names in sets]
    beside = [f["effect"] for f, is_met in zip(row["findings"], met, strict=True) if not is_met]
    if case.control:
        told = _parts(set().union(*sets, _nameless(row)))
        right = not _with_kinds(told - set(case.known)) & set(case.accepted)
    else:
        right = any(met) or _accepted(_nameless(row), case.accepted)
    return {**row, "first": right and (not met or met[0]), "beside": beside, "right": right}


def _edited(case: Edited, row: Mapping[str, Any]) -> dict[str, Any]:
    """The effect, with nothing else beside it: its first parameter as large as the edit, a second one nothing.

    Both beyond what the drive showed of them `before`.
    """
    told = next((f["values"] for f in row["findings"] if f["effect"] == case.effect), None)
    beside = [f["effect"] for f in row["findings"] if f["effect"] != case.effect]
    first, *others = row["before"]
    made = {first: case.value, **dict.fromkeys(others, 0.0)}
    right = told is not None and all(_near(told[s], row["before"][s], made[s], abs(case.value)) for s in made)
    return {**row, "value": told[first][0] if told else None, "beside": beside, "right": right and not beside}


def _near(value: Sequence[float], before: Sequence[float], made: float, size: float) -> bool:
    """Whether a parameter is what was made of it beyond what it was before, for an edit of such a size."""
    off, se = value[0] - before[0] - made, math.hypot(value[1], before[1])
    return abs(off) < min(max(NEAR * size, SURE * se), FARTHEST * size)


def _accepted(names: Set[str], accepted: Sequence[str]) -> bool:
    """Whether one of the names is accepted; several that are alike only together, if all of them are."""
    return any(set(name.split("+")) <= set(accepted) for name in names)


def _nameless(answer: Mapping[str, Any]) -> set[str]:
    """What the answer says of what has no name."""
    return {f"unknown in {answer['remainder']['channel']}"} if answer["verdict"] == "unknown" else set()


def _parts(names: Set[str]) -> set[str]:
    """Every effect that the names may mean."""
    return {part for name in names for part in name.split("+")}


def _with_kinds(named: Set[str]) -> set[str]:
    """The names, and VEHICLE where one of them is the vehicle's."""
    return {*named, *(EFFECTS[e].kind for e in named if e in EFFECTS and EFFECTS[e].kind == VEHICLE)}


SCHEMA = "bcid.prove-real/1"


TIERS = ("withheld", "control", "edited")


def outcome(rows: Sequence[Mapping[str, Any]], code: str) -> dict[str, Any]:
    """All rows in order, and right answers of how many, tier by tier; `code` is the digest of what made them.

    Of what was withheld also how many are right by a name, how many of these stand first, how many have no other beside
    them, and of all names how many are accepted.  What makes no difference to the error where it is withheld does not
    count.
    """
    rows = sorted(rows, key=lambda r: (TIERS.index(r["tier"]), r["recording"], r["case"]))
    counted = [r for r in rows if r["verdict"] != NOT_ASKED]
    tiers = {
        tier: {"right": sum(r["right"] for r in of), "n": len(of)}
        for tier in dict.fromkeys(r["tier"] for r in rows)
        for of in [[r for r in counted if r["tier"] == tier]]
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

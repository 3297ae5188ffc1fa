"""What the answers of real recordings amount to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bcid.proof.real_cases import NOT_ASKED

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

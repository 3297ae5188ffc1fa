"""How many verdicts change where a limit is halved or doubled (limits.json)."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from bcid.documents.varied_limits import ChangedVerdict, FailedTake, VariedLimit, VariedLimitsDocument
from bcid.proof.limits import LIMITS


class VariedRow(NamedTuple):
    """The verdict of one take with one limit "halved" or "doubled", or without a limit, with all as they are."""

    case: str
    there: str  # effects that are concealed
    limit: str
    change: str
    told: Mapping[str, Any]  # "verdict", "names" and "channel", or "error"

    @property
    def words(self) -> str:
        """The verdict in words."""
        if "error" in self.told:
            return str(self.told["error"])
        channel = f" in {self.told['channel']}" if self.told["channel"] else ""
        names = ", ".join(self.told["names"])
        return str(self.told["verdict"]) + channel + (f": {names}" if names else "")


def count_changes(
    rows: Sequence[VariedRow], values: Mapping[str, Mapping[str, float]], about: Mapping[str, Any], example: str
) -> VariedLimitsDocument:
    """The document limits.json: for each limit how many verdicts of the `rows` are others with half and twice of it.

    `values` has for each limit its value as it is (""), "halved" and "doubled"; `about` has seed, code and panel, which
    are copied; `example` is the name of the take whose verdict may never change.  A take counts for a limit if its
    verdict is known with all three values.  One that ends in an error with another value only, has changed.
    """
    told = {(row.case, row.limit, row.change): row for row in rows}
    as_is = {case: row for (case, limit, _), row in told.items() if not limit and "error" not in row.told}
    limits, changes, complete = list[VariedLimit](), list[ChangedVerdict](), set(as_is)
    for limit, value in values.items():
        known = [case for case in as_is if {(case, limit, "halved"), (case, limit, "doubled")} <= told.keys()]
        complete &= set(known)
        both = [told[case, limit, change] for change in ("halved", "doubled") for case in known]
        changed = [row for row in both if row.told != as_is[row.case].told]
        halved = sum(row.change == "halved" for row in changed)
        limits.append(
            VariedLimit(
                limit=limit, value=value[""], halved=value["halved"], doubled=value["doubled"], takes=len(known),
                changed_halved=halved, changed_doubled=len(changed) - halved,
                changed_share=len(changed) / len(both) if both else None,
            )
        )  # fmt: skip
        changes += [
            ChangedVerdict(
                case=row.case, there=row.there, limit=limit, value=value[row.change], before=as_is[row.case].words,
                after=row.words,
            )
            for row in changed
        ]  # fmt: skip
    failed = [
        FailedTake(
            case=row.case, error=row.words, limit=row.limit, value=values[row.limit][row.change] if row.limit else None
        )
        for row in rows
        if "error" in row.told
    ]
    document = VariedLimitsDocument(
        **about, diagnosed=len(complete), limits=tuple(limits), changes=tuple(changes), failed=tuple(failed),
        goal=LIMITS.max_changed_share,
    )  # fmt: skip
    return document.model_copy(update={"missed": tuple(_missed_goals(document, example))})


def _missed_goals(document: VariedLimitsDocument, example: str) -> list[str]:
    """Sentences on limits with which too many verdicts change, on the `example` if its does, and on failed takes."""
    return [
        *(
            f"{v.limit}: {v.changed_halved + v.changed_doubled} of {2 * v.takes} verdicts change"
            for v in document.limits
            if (v.changed_share or 0.0) > document.goal
        ),
        *(f"{c.case}: changes where {c.limit} is {c.value:g}" for c in document.changes if c.case == example),
        *(f"{f.case}: no verdict" for f in document.failed if not f.limit),
    ]

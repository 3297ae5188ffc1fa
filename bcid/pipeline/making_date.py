"""The date that a run writes into what it makes: now, or the one that SOURCE_DATE_EPOCH states."""

import os
from datetime import UTC, datetime

from bcid.errors import UsageError

VARIABLE = "SOURCE_DATE_EPOCH"


def making_date() -> datetime:
    """The time of day, or what SOURCE_DATE_EPOCH says it is (s since 1970), by which two runs leave the same bytes.

    Raises:
        UsageError: SOURCE_DATE_EPOCH is no such number, or lies beyond the calendar.
    """
    stated = os.environ.get(VARIABLE, "")
    if not stated:
        return datetime.now(UTC)
    try:
        return datetime.fromtimestamp(int(stated), UTC)
    except (ValueError, OverflowError, OSError):
        raise UsageError(
            f"{VARIABLE}: {stated[:40]!r} is no date\n  next: give whole seconds since 1970 UTC, or unset it"
        ) from None

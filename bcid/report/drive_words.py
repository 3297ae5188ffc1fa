"""The drive that tells explanations apart, in words: what it tells, from where it sets off, what it needs."""

from math import degrees

from bcid.documents.diagnosis import NextManoeuvre
from bcid.report.formats import format_rounded, join_words, plain_name


def describe_drive(drive: NextManoeuvre, urgent: bool) -> str:
    """What to drive, how often, from where, and what it tells; `urgent` where names hang on it."""
    times = f"{drive.repeats} times" if drive.repeats > 1 else "once"
    why = "" if urgent else " to be surer, though the names do not hang on it"
    told = f" It tells {join_words([plain_name(n) for n in drive.separates])} apart." if drive.separates else ""
    start = describe_start(drive)
    return (
        f"Drive {drive.name} {times}{why}: its commands lie ready in {drive.file}.{told}{' ' if start else ''}{start}"
    )


def describe_start(drive: NextManoeuvre) -> str:
    """From where a drive sets off, how long it lasts, which floor it needs; empty where a document has no start.

    >>> from bcid.documents.diagnosis import Start
    >>> describe_start(NextManoeuvre(start=Start(x_m=-0.409, y_m=1.44, yaw_rad=2.094), seconds=28.0))
    'Set the car down at rest at x = −0.41 m, y = 1.44 m, heading 120°, its wheel straight; the drive takes 28 s.'
    """
    if drive.start is None:
        return ""
    x, y, heading = (
        format_rounded(value, places)
        for value, places in ((drive.start.x_m, 2), (drive.start.y_m, 2), (degrees(drive.start.yaw_rad), 0))
    )
    text = f"Set the car down at rest at x = {x} m, y = {y} m, heading {heading}°, its wheel straight"
    if drive.seconds is not None:
        text += f"; the drive takes {drive.seconds:.0f} s"
    if drive.floor is None:
        return f"{text}."
    sides = (
        f"{axis} = {format_rounded(low, 1)} to {format_rounded(high, 1)} m"
        for axis, (low, high) in (("x", drive.floor.x_m), ("y", drive.floor.y_m))
    )
    return (
        f"{text}, and keeps to {' and '.join(sides)} if the car is the fitted one: nothing steers it back, so watch it."
    )

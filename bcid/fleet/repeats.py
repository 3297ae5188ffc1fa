"""Which logs of a fleet are of one drive, as where an archive holds copies: they are no further evidence."""

from __future__ import annotations

from collections.abc import Mapping

from bcid.evaluation.seen_takes import TakeSteps, is_same_drive


def find_repeats(takes: Mapping[int, TakeSteps]) -> dict[int, int]:
    """Numbers of the takes that are of the drive of an earlier one, at least in part, with the number of that one.

    Only takes that share a step are compared, so that the work grows with the number of takes.
    """
    holders, repeats = dict[int, list[int]](), dict[int, int]()
    for number, take in sorted(takes.items()):
        sharing = {other for step in take.steps for other in holders.get(step, ())}
        first = next((other for other in sorted(sharing) if is_same_drive(take, takes[other])), None)
        if first is not None:
            repeats[number] = first
            continue
        for step in take.steps:
            holders.setdefault(step, []).append(number)
    return repeats

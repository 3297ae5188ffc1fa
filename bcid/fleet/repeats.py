"""Which logs of a fleet are of one drive, as where an archive holds copies: they are no further evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from bcid.evaluation.seen_takes import TakeSteps, is_same_drive


def find_repeats(takes: Mapping[int, TakeSteps]) -> dict[int, int]:
    """Numbers of the takes that are of the drive of an earlier one, at least in part, with the number of that one.

    They go in the order of `takes`.  Only takes that share a step are compared, so that the work grows with the number
    of takes, and only steps that are shared are remembered, so that memory hardly does.
    """
    shared, holders, repeats = _shared_steps(takes.values()), dict[int, list[int]](), dict[int, int]()
    place = {number: i for i, number in enumerate(takes)}
    for number, take in takes.items():
        own = shared.intersection(take.steps)
        sharing = {other for step in own for other in holders.get(step, ())}
        first = next(
            (other for other in sorted(sharing, key=place.__getitem__) if is_same_drive(take, takes[other])), None
        )
        if first is not None:
            repeats[number] = first
            continue
        for step in own:
            holders.setdefault(step, []).append(number)
    return repeats


def _shared_steps(takes: Iterable[TakeSteps]) -> set[int]:
    """The numbers of the steps that more than one of the takes have."""
    all_steps = np.concatenate([np.zeros(0, np.uint64), *(np.array(take.steps, np.uint64) for take in takes)])
    steps, counts = np.unique(all_steps, return_counts=True)
    return set(steps[counts > 1].tolist())

"""Copies in an archive: which logs of a fleet are of one drive, and that finding them costs no comparison of all."""

from __future__ import annotations

import numpy as np
import pytest

from bcid.evaluation.limits import LIMITS
from bcid.evaluation.seen_takes import TakeSteps, number_steps
from bcid.fleet import repeats
from bcid.fleet.repeats import find_repeats


def drive(seed: int, poses: int = 4000) -> np.ndarray:
    """Positions (N, 2) of a drive along a path of its own."""
    return np.cumsum(np.random.default_rng(seed).normal(0.0, 0.02, (poses, 2)), axis=0)


def take(path: np.ndarray) -> TakeSteps:
    return TakeSteps("", number_steps(path)).keep_some()


def test_copies_and_parts_are_found_whatever_lies_between() -> None:
    """The second half of a drive is of that drive; the first of several copies counts for all."""
    takes = {2: take(drive(1)), 5: take(drive(2)), 6: take(drive(1)), 7: take(drive(2)[2000:]), 9: take(drive(1))}
    assert find_repeats(takes) == {6: 2, 7: 5, 9: 2}


def test_drives_of_their_own_are_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    def compare(one: TakeSteps, other: TakeSteps) -> bool:
        pytest.fail("two drives were compared that share no step")

    monkeypatch.setattr(repeats, "is_same_drive", compare)
    assert find_repeats({number: take(drive(number)) for number in range(40)}) == {}
    assert len(take(drive(0)).steps) == LIMITS.kept_steps


def test_a_stand_is_of_no_drive() -> None:
    assert find_repeats({0: take(np.zeros((50, 2))), 1: take(np.zeros((50, 2)))}) == {}

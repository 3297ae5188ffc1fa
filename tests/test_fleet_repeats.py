"""Copies in an archive: which logs of a fleet are of one drive, and that finding them costs no comparison of all."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pytest

from bcid.documents.fleet import FleetLog, KeptArtifact
from bcid.evaluation.limits import LIMITS
from bcid.evaluation.seen_takes import TakeSteps, number_steps
from bcid.fleet import repeats
from bcid.fleet.labels import FleetLabels
from bcid.fleet.repeats import find_repeats
from bcid.fleet.run import FleetJob, _Fleet
from bcid.fleet.tasks import FleetOrder, WorkedLog


def drive(seed: int, poses: int = 4000) -> np.ndarray:
    """Positions (N, 2) of a drive along a path of its own."""
    return np.cumsum(np.random.default_rng(seed).normal(0.0, 0.02, (poses, 2)), axis=0)


def take(path: np.ndarray) -> TakeSteps:
    return TakeSteps("", number_steps(path)).keep_some()


def test_a_short_part_is_found_by_the_steps_that_both_would_keep() -> None:
    """A thirtieth of a drive keeps all of its steps, of which the whole drive keeps hardly any."""
    whole = drive(1, 20_000)
    assert find_repeats({0: take(whole), 1: take(whole[8000:8700])}) == {1: 0}


def test_of_one_drive_the_log_that_was_diagnosed_counts() -> None:
    """An earlier copy that could not be fitted, or was not to be used, says nothing in its place."""
    fleet = _Fleet(cast(FleetOrder, None), [Path(f"{name}.csv") for name in "abc"], cast(FleetLabels, None))
    for number, stages in enumerate((("ingest",), ("ingest", "diagnose"), ("ingest", "diagnose"))):
        kept = tuple(KeptArtifact(stage=stage, key="0" * 64) for stage in stages)
        row = FleetLog(name="abc"[number], file="", state="done", artifacts=kept)
        fleet.take_over(FleetJob("log", number, False), WorkedLog(row, take(drive(1))))
    assert fleet.repeats == {0: 1, 2: 1}


def test_a_few_equal_steps_are_chance() -> None:
    shared = take(drive(1)).steps[:5]
    mixed = TakeSteps("", tuple(sorted({*shared, *take(drive(2)).steps[:20]})))
    assert find_repeats({0: take(drive(1)), 1: mixed}) == {}


def test_the_first_in_order_counts_whatever_its_number() -> None:
    assert find_repeats({6: take(drive(1)), 2: take(drive(1)), 4: take(drive(1))}) == {2: 6, 4: 6}


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

"""Which takes a model was made from: some of their steps, saved beside the model as takes.json.

A take is known by its steps, pairs of positions that follow each other.  Two drives share hardly any, whatever their
places: measured positions do not repeat.  The same take shares all of them with itself, also under another name, in
another format, cut, or with other commands.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from bcid.aliases import Floats
from bcid.documents.document import Document, Part
from bcid.errors import InputRefused
from bcid.evaluation.limits import LIMITS
from bcid.files.json import read_json, write_json
from bcid.files.parquet import read_columns
from bcid.recording.saving import POSE_UNITS, RecordingSummary

FILE_NAME = "takes.json"
RESOLUTION_M = 1e-6
"""Positions are compared to this: what most formats are written with."""
_BITS = 53
"""Bits of a step's number, so that a JSON reader keeps all of them."""

_Numbers = npt.NDArray[np.uint64]


class TakeSteps(NamedTuple):
    """A take's name, and the numbers of its steps, sorted and without repeats."""

    name: str
    steps: tuple[int, ...]

    def keep_some(self) -> TakeSteps:
        """The take with its steps of the smallest numbers, by which it is known: they are as good as drawn by lot."""
        return self._replace(steps=self.steps[: LIMITS.kept_steps])


class _SeenTake(Part):
    """A take that a model was made from, with those of its steps whose numbers are smallest."""

    name: str
    steps: tuple[Annotated[int, Field(ge=0, lt=2**_BITS)], ...]


class _SeenTakesDocument(Document):
    """The whole of takes.json."""

    kind: Literal["bcid.takes/1"] = Field("bcid.takes/1", alias="schema")
    takes: tuple[_SeenTake, ...]


def number_steps(position: Floats) -> tuple[int, ...]:
    """Numbers of the steps of a path (N, 2) (m), sorted and without repeats: equal steps have equal numbers.

    A number is the two positions, in RESOLUTION_M, mixed into 53 bits (splitmix64); a stand is no step.
    """
    # in whole numbers, of which those below zero wrap around, as they do in a hash
    cells = np.round(position / RESOLUTION_M).astype(np.int64).view(np.uint64)
    moved = (cells[1:] != cells[:-1]).any(axis=1)
    mixed: _Numbers = np.zeros(int(moved.sum()), dtype=np.uint64)
    for column in (*cells[:-1][moved].T, *cells[1:][moved].T):
        mixed = _mix(mixed ^ column)
    return tuple(np.unique(mixed >> np.uint64(64 - _BITS)).tolist())


def _mix(number: _Numbers) -> _Numbers:
    """Numbers of 64 bits, each bit of which depends on all of `number` (splitmix64, Steele et al. 2014)."""
    z = number + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def read_take_steps(recording: Path) -> TakeSteps:
    """The steps of the take in the artifact folder `recording`."""
    name = RecordingSummary.read(recording / "recording.json").name
    return TakeSteps(name, number_steps(read_columns(recording / "poses.parquet", POSE_UNITS)[:, 1:3]))


def shared_share(one: TakeSteps, other: TakeSteps) -> float:
    """The share of the shorter take's steps that are in the other one, too; 0 where so few are that it may be chance.

    Where only some steps are kept they are those of the smallest numbers: counted are steps up to the smaller of both
    takes' largest numbers, which are all there.
    """
    last = min(one.steps[-1:] + other.steps[-1:], default=0)
    mine, others = ({step for step in take.steps if step <= last} for take in (one, other))
    shared, fewer = len(mine & others), min(len(mine), len(others))
    enough = min(LIMITS.least_shared_steps, len(one.steps), len(other.steps))
    return shared / fewer if fewer and shared >= enough else 0.0


def is_same_drive(one: TakeSteps, other: TakeSteps) -> bool:
    """Whether two takes are of the same drive, at least in part; of either of them only some steps may be kept."""
    return shared_share(one, other) > LIMITS.max_shared_steps


def save_seen_takes(takes: Sequence[TakeSteps], folder: Path) -> None:
    """Write takes.json beside the model in `folder`, which was made from the `takes`, of whose steps some are kept."""
    kept = tuple(_SeenTake(name=t.name, steps=t.keep_some().steps) for t in takes)
    write_json(folder / FILE_NAME, _SeenTakesDocument(takes=kept).as_json())


def load_seen_takes(folder: Path) -> list[TakeSteps] | None:
    """The takes, with some of their steps, that the model in `folder` was made from; None where nobody wrote them.

    Raises:
        InputRefused: takes.json cannot be read.
    """
    path = folder / FILE_NAME
    if not path.exists():
        return None
    try:
        document = _SeenTakesDocument.from_json(json.dumps(read_json(path)))
    except (OSError, ValueError) as error:
        next_step = "fit the model again, or remove the file"
        raise InputRefused(path, FILE_NAME, f"cannot be read: {error}", next_step) from None
    return [TakeSteps(take.name, take.steps) for take in document.takes]


def has_seen(seen: Sequence[TakeSteps] | None, take: TakeSteps) -> bool | None:
    """Whether one of the takes that a model was made from is of the same drive as `take`; None where it is not known.

    Of a very short part of a take too few steps may be among those that are kept of it.
    """
    return None if seen is None else any(is_same_drive(other, take) for other in seen)

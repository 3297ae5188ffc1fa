"""Which take is which: names that tell takes apart, and the refusal of one that is given twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bcid.errors import InputRefused

if TYPE_CHECKING:
    from bcid.evaluation.seen_takes import TakeSteps


def name_takes(recordings: Sequence[Path]) -> dict[Path, str]:
    """Names of recordings by path: a file's name without its ending, and what more it takes to tell them apart.

    >>> paths = [Path("a/drive.csv"), Path("b/drive.csv"), Path("b/circle.csv"), Path("b/circle.mcap")]
    >>> list(name_takes(paths).values())
    ['a/drive', 'b/drive', 'circle.csv', 'circle.mcap']
    """
    paths = dict.fromkeys(recordings)
    names = {path: path.stem for path in paths}
    for depth in range(max((len(path.parts) for path in paths), default=0) + 1):
        counts = Counter(names.values())
        for path in [p for p in paths if counts[names[p]] > 1]:
            longer = Path(*path.parts[-depth - 1 :])
            alone = sum(longer.with_suffix("") == Path(*p.parts[-depth - 1 :]).with_suffix("") for p in paths) == 1
            names[path] = (longer.with_suffix("") if alone else longer).as_posix()
    return names


def refuse_repeats(
    recordings: Sequence[Path], against: Sequence[Path], steps_of: Callable[[Path], TakeSteps], source: str, place: str,
    next_step: str,
) -> None:  # fmt: skip
    """Do nothing where each of `recordings` is of another drive than those `against` it, and than the ones before it.

    `steps_of` gives a recording's steps.

    Raises:
        InputRefused: two are of the same drive, at least in part, which the key `place` of the file `source` names.
    """
    from bcid.evaluation.seen_takes import is_same_drive

    for number, recording in enumerate(recordings):
        for other in (*against, *recordings[:number]):
            if is_same_drive(steps_of(recording), steps_of(other)):
                again = "named twice" if recording == other else f"{other} once more, or a part of it"
                raise InputRefused(source, place, f"{recording} is {again}: the same drive", next_step)

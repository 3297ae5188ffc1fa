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
    >>> list(name_takes([Path("a/drive.csv[0:60]"), Path("a/drive.csv[60:]")]).values())
    ['drive[0:60]', 'drive[60:]']
    """
    # a cut counts to the name, before the file's ending
    paths = {path: _cut_before_ending(path) for path in recordings}
    names = {path: _without_ending(shown).name for path, shown in paths.items()}
    for depth in range(max((len(path.parts) for path in paths), default=0) + 1):
        counts = Counter(names.values())
        alike = [path for path in paths if counts[names[path]] > 1]
        if not alike:
            break
        longer = {path: Path(*shown.parts[-depth - 1 :]) for path, shown in paths.items()}
        others = Counter(map(_without_ending, longer.values()))
        for path in alike:
            bare = _without_ending(longer[path])
            names[path] = (bare if others[bare] == 1 else longer[path]).as_posix()
    return names


def _cut_before_ending(path: Path) -> Path:
    """The path of a recording with its cut, if any, before the file's ending.

    >>> _cut_before_ending(Path("a/take.csv[2:9]")).as_posix()
    'a/take[2:9].csv'
    """
    file, bracket, cut = path.name.rpartition("[")
    named = Path(file)
    return path.with_name(f"{named.stem}[{cut}{named.suffix}") if bracket and cut.endswith("]") else path


def _without_ending(path: Path) -> Path:
    """The path without the file's ending, which is not the end of a cut such as "[1.5:2]"."""
    return path if path.suffix.endswith("]") else path.with_suffix("")


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

"""What a command writes appears whole or not at all, and in the place of nothing that was to be kept.

Files are written into a folder of their own beside their places, checked together, and moved there last.
"""

import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from bcid.errors import DiskFull, InputRefused, is_disk_full
from bcid.files.limits import LIMITS

PREFIX, SUFFIX = ".bcid-", ".part"
OTHER_FOLDER = "name another folder with --out"

MayReplace = Callable[[Path], bool]
"""Whether the file that lies at a path may be replaced."""


def refuse_to_overwrite(targets: Iterable[Path], may_replace: MayReplace, other_place: str = OTHER_FOLDER) -> None:
    """Do nothing where each of the `targets` can be written: nothing lies there, or a file that `may_replace` allows.

    Raises:
        InputRefused: something else lies there; all such files are named.  `other_place` says how to choose another.
    """
    there = [path for path in targets if os.path.lexists(path)]
    odd = [path for path in there if not path.is_symlink() and not path.is_file()]
    if odd:
        raise InputRefused(odd[0], "output", "is there already, and is no file that could be replaced", other_place)
    kept = [path for path in there if not may_replace(path)]
    if kept:
        files = "this file" if len(kept) == 1 else "these files"
        cause = f"exists already and would be overwritten{_others(kept)}"
        raise InputRefused(kept[0], "output", cause, f"{other_place}, or write over {files} with --force")


def _others(paths: list[Path]) -> str:
    """The paths after the first, as text that follows a sentence on the first."""
    return f"; so would {', '.join(map(str, paths[1:]))}" if len(paths) > 1 else ""


@contextmanager
def explain_write_errors(place: Path, next_step: str) -> Iterator[None]:
    """Context in which writing to the folder `place` may fail: on a full disk, without permission, under a file.

    Raises:
        DiskFull: the disk is full.
        InputRefused: an error of the operating system on `place`, or on a path in it; `next_step` says what to do.
    """
    try:
        yield
    except OSError as error:
        if is_disk_full(error):
            raise DiskFull(place) from error
        if error.filename is None or not _is_within(Path(os.fsdecode(error.filename)), place):
            raise
        is_file = isinstance(error, FileExistsError | NotADirectoryError)
        cause = "is or lies in a file, and no folder" if is_file else f"cannot be written to: {error.strerror or error}"
        raise InputRefused(os.fsdecode(error.filename), "output", cause, next_step) from error


def _is_within(path: Path, place: Path) -> bool:
    """Whether `path` is the folder `place`, in it, or one of the folders in which it would have to be made."""
    path, place = Path(os.path.abspath(path)), Path(os.path.abspath(place))
    return path == place or place in path.parents or path in place.parents


@contextmanager
def staged_outputs(home: Path, may_replace: MayReplace, other_place: str = OTHER_FOLDER) -> Iterator[Path]:
    """Context with a new folder to write files into, which at its end are moved to their places in `home`, all or none.

    A file that was there is replaced in one step, and only where `may_replace` allows it.  After an error or an
    interruption `home` is as it was before.

    Raises:
        InputRefused: a file would be overwritten that may not be, or `home` cannot be written to.
        DiskFull: the disk is full.
    """
    with explain_write_errors(home, f"{other_place} that can be written to"):
        # named before any of it is made: an interruption may come between a folder and the line after it
        missing, work = _missing_folders(home), home / f"{PREFIX}{uuid4().hex}{SUFFIX}"
        staged, aside = work / "new", work / "old"
        try:
            home.mkdir(parents=True, exist_ok=True)
            _remove_stale_parts(home)
            work.mkdir(mode=0o700)
            staged.mkdir()
            yield staged
            aside.mkdir()
            _place_all(staged, home, aside, may_replace, other_place)
        finally:
            shutil.rmtree(work, ignore_errors=True)
            _remove_empty(missing)


def write_output(path: Path, write: Callable[[Path], object], may_replace: MayReplace, other_place: str) -> None:
    """Write one file by `write(unfinished_path)` and move it to `path` when it is whole.

    Raises:
        InputRefused: a file lies there that `may_replace` does not allow to replace, or the folder cannot be written.
        DiskFull: the disk is full.
    """
    with staged_outputs(path.parent, may_replace, other_place) as folder:
        write(folder / path.name)


def replace_whole(path: Path, write: Callable[[Path], object], other_place: str = OTHER_FOLDER) -> None:
    """Write a file of our own by `write(unfinished_path)`, and let it replace the one at `path` in one step."""
    write_output(path, write, lambda there: True, other_place)


def _missing_folders(home: Path) -> list[Path]:
    """The folders that would have to be made for `home` to exist, the innermost first."""
    return [folder for folder in (home, *home.parents) if not os.path.lexists(folder)]


def _remove_empty(folders: list[Path]) -> None:
    """Remove those of `folders` that hold nothing, which are those of a run that failed; in the order given."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def _remove_stale_parts(home: Path) -> None:
    """Remove folders of unfinished files in `home` that a killed run left, older than any run lasts."""
    for left in home.glob(f"{PREFIX}*{SUFFIX}"):
        with suppress(OSError):
            if time.time() - left.stat().st_mtime > LIMITS.max_run_s:
                shutil.rmtree(left, ignore_errors=True)


def _place_all(staged: Path, home: Path, aside: Path, may_replace: MayReplace, other_place: str) -> None:
    """Move all files in `staged` to their places in `home`, or none; `aside` is an empty folder for those replaced."""
    files = sorted(p for p in staged.rglob("*") if p.is_file())
    targets = [home / p.relative_to(staged) for p in files]
    refuse_to_overwrite(targets, may_replace, other_place)
    for path in files:
        flush_to_disk(path)
    placed = list[tuple[Path, Path | None]]()
    made = list[Path]()
    try:
        for number, (path, target) in enumerate(zip(files, targets, strict=True)):
            made = _missing_folders(target.parent) + made
            target.parent.mkdir(parents=True, exist_ok=True)
            old = aside / str(number) if os.path.lexists(target) else None
            if old is not None:
                shutil.copy2(target, old, follow_symlinks=False)
            placed.append((target, old))
            path.replace(target)
    except BaseException:
        for target, old in placed:
            if old is not None:
                old.replace(target)
            else:
                target.unlink(missing_ok=True)
        _remove_empty(made)
        raise


def flush_to_disk(path: Path) -> None:
    """Wait until the file at `path` is on the disk, so that a power cut after its move leaves no empty file."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())

"""Copies of an artifact's files where people look for them."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from bcid.errors import UsageError


def publish_copies(folder: Path, names: Sequence[str], home: Path) -> Path:
    """Copy the files and folders `names` from `folder` to `home`, which loses those that `folder` lacks.

    Returns the path of the first copy.  Only one run at a time may do so.

    Raises:
        UsageError: a folder of such a name holds something else than a saved model.
    """
    home.mkdir(parents=True, exist_ok=True)
    for left in home.glob(".*.unfinished"):  # by a run that was killed
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    for name in names:
        there = home / name
        if there.is_dir() and any(there.iterdir()) and not (there / "model.json").exists():
            raise UsageError(f"{there} holds something else than a model\n  next: choose another --out")
    for name in names:
        _replace_with_copy(folder / name, home / name)
    return home / names[0]


def _replace_with_copy(source: Path, target: Path) -> None:
    """Replace `target` by a copy of `source`; whenever a run is killed, the old one, the new one or none is there."""
    beside, aside = (target.with_name(f".{target.name}.{what}.unfinished") for what in ("new", "old"))
    if source.is_dir():
        shutil.copytree(source, beside)
        if target.exists():
            target.replace(aside)
        beside.replace(target)
        shutil.rmtree(aside, ignore_errors=True)
    elif source.exists():
        shutil.copyfile(source, beside)
        beside.replace(target)
    else:
        target.unlink(missing_ok=True)

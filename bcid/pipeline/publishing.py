"""Copies of an artifact's files where people look for them."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from bcid.errors import UsageError


def publish_copies(folder: Path, names: Sequence[str], home: Path) -> Path:
    """Replace `names`, files and folders in `home`, by copies of those of the same names in `folder`.

    A file of `names` that `folder` lacks is removed from `home`.  Returns the path of the first copy.  Only one run
    at a time may call it.

    Raises:
        UsageError: a folder of such a name in `home` holds something other than a saved model.
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
    """Replace the file or folder `target` by a copy of `source`; remove the file `target` where there is no `source`.

    If the run is killed meanwhile, `target` is the old one, the new one or absent, never a part of one.
    """
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

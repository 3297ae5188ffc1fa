"""Copies of an artifact's files where people look for them."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from bcid.errors import UsageError


def publish_copies(folder: Path, names: Sequence[str], home: Path) -> Path:
    """Copy files and folders `names` of `folder` to `home`, and remove there what `folder` lacks; returns the first.

    Only one run at a time may do so.

    Raises:
        UsageError: where a folder of such a name holds something else than a saved model.
    """
    home.mkdir(parents=True, exist_ok=True)
    for left in home.glob(".*.unfinished"):  # by a run that was killed
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    for name in names:
        if (home / name).is_dir() and any((home / name).iterdir()) and not is_model(home / name):
            raise UsageError(f"{home / name} holds something else than a model\n  next: choose another --out")
    for name in names:
        _exchange(folder / name, home / name)
    return home / names[0]


def _exchange(source: Path, target: Path) -> None:
    """Put a copy of `source` in the place of `target`; at every moment there is the old one, the new one or none."""
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


def is_model(folder: Path) -> bool:
    """Whether a folder holds a saved model."""
    return (folder / "model.json").exists()

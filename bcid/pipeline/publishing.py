"""Copies of an artifact's files where people look for them."""

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from bcid.documents.manifest import ManifestDocument
from bcid.errors import InputRefused
from bcid.files.outputs import explain_write_errors, flush_to_disk, refuse_to_overwrite
from bcid.store.artifact import MANIFEST, OTHER_WORKSPACE, file_sha256

UNFINISHED = ".*.unfinished"
"""Names of copies that are not yet in their places."""


def publish_copies(folder: Path, names: Sequence[str], home: Path, known: frozenset[str], force: bool = False) -> Path:
    """Replace `names`, files and folders in `home`, by copies of those of the same names in `folder`.

    What of `names` `folder` lacks is removed from `home`.  Returns the path of the first copy.  Only one run
    at a time may call it.

    Raises:
        InputRefused: of such a name there is something else than a copy of an artifact (`known`, digests by
            `artifact_digests`) and not `force`; or `home` cannot be written to.
        DiskFull: the disk is full.
    """
    refuse_to_replace(names, home, known, force)
    with explain_write_errors(home, OTHER_WORKSPACE):
        home.mkdir(parents=True, exist_ok=True)
        for left in home.glob(UNFINISHED):  # by a run that was killed
            _remove(left)
        for name in names:
            _replace_with_copy(folder / name, home / name)
    return home / names[0]


def are_published(folder: Path, names: Sequence[str], home: Path) -> bool:
    """Whether `home` holds just the copies of `names`, files and folders in `folder`, and nothing unfinished."""
    return not any(home.glob(UNFINISHED)) and all(_content(folder, name) == _content(home, name) for name in names)


def refuse_to_replace(names: Sequence[str], home: Path, known: frozenset[str], force: bool = False) -> None:
    """Do nothing where what lies in `home` under `names` is nothing, or copies whose digests are `known`.

    Raises:
        InputRefused: a file is there that was edited, or that bcid did not write, and not `force`.
    """
    there = {home / file: digest for name in names for file, digest in _content(home, name).items()}
    other = 'move it away, name another folder with --out or by workspace = "…" in the pipeline file'
    refuse_to_overwrite(there, lambda path: force or there[path] in known, other)


def artifact_digests(workspace: Path) -> frozenset[str]:
    """SHA-256 of all files that the artifacts in `workspace` were written with, by their manifests."""

    def manifests() -> Iterator[ManifestDocument]:
        for path in workspace.glob(f"*/*/{MANIFEST}"):
            try:
                yield ManifestDocument.read(path)
            except InputRefused:
                continue

    return frozenset(digest for manifest in manifests() for digest in manifest.files.values())


def _content(home: Path, name: str) -> dict[str, str]:
    """SHA-256 of the file `name` in `home`, or of all files in the folder of that name, by path from `home`."""
    path = home / name
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else []
    return {p.relative_to(home).as_posix(): file_sha256(p) for p in files}


def _replace_with_copy(source: Path, target: Path) -> None:
    """Replace the file or folder `target` by a copy of `source`, or remove it where there is no `source`.

    If the run is killed meanwhile, `target` is the old one, the new one or absent, never a part of one.
    """
    beside, aside = (target.with_name(f".{target.name}.{what}.unfinished") for what in ("new", "old"))
    try:
        if source.is_dir():
            shutil.copytree(source, beside)
        elif source.exists():
            shutil.copyfile(source, beside)
            flush_to_disk(beside)
        # a file replaces a file in one step; a folder must be out of the way first
        if target.exists() and not (target.is_file() and beside.is_file()):
            target.replace(aside)
        if beside.exists():
            beside.replace(target)
        _remove(aside)
    except BaseException:
        _remove(beside)
        if aside.exists() and not target.exists():
            aside.replace(target)
        raise


def _remove(path: Path) -> None:
    """Remove the file or folder at `path`, or do nothing where nothing is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)

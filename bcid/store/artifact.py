"""`WORKSPACE/<stage>/<key>/`: a stage's files with a manifest; the key covers all that they depend on."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bcid.errors import DiskFull, InputRefused, is_disk_full
from bcid.files.source_code import Code

MANIFEST = "manifest.json"
_WORK = ".unfinished"
PATIENCE_S = 1.0  # before somebody is told that another run is waited for
STALE_S = 24 * 3600.0  # no stage takes a day
PUBLISH_TRIES = 3


@dataclass(frozen=True)
class Recipe:
    """All that an artifact depends on."""

    stage: str
    inputs: Mapping[str, Any]  # by content: hashes of files, keys of other artifacts
    settings: Mapping[str, Any]
    code: Code
    seed: int | None = None

    def as_json(self) -> dict[str, Any]:
        """For the manifest."""
        return {
            "schema": "bcid.artifact/1",
            "stage": self.stage,
            "inputs": dict(self.inputs),
            "settings": dict(self.settings),
            "code": self.code.digest,
            "packages": self.code.packages,
            "seed": self.seed,
        }

    @property
    def key(self) -> str:
        """The artifact's name: a digest of the recipe."""
        text = json.dumps(self.as_json(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:20]


@dataclass(frozen=True)
class Artifact:
    """A finished folder."""

    folder: Path
    key: str
    reused: bool

    @property
    def content(self) -> str:
        """A digest of its files, whatever made them: what depends on it is keyed by this."""
        files = self.json(MANIFEST)["files"]
        return hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest()[:20]

    def json(self, name: str) -> Any:
        """The content of one of its JSON files."""
        return json.loads((self.folder / name).read_text(encoding="utf-8"))


def sha256_of(path: Path) -> str:
    """Digest of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Store:
    """The artifacts of one workspace."""

    def __init__(self, workspace: Path, waiting: Callable[[], None] = lambda: None) -> None:
        """The artifacts under `workspace`; `waiting` is called when another run keeps this one waiting."""
        self.workspace = workspace
        self._waiting = waiting

    def get(self, recipe: Recipe, make: Callable[[Path], None]) -> Artifact:
        """The artifact of `recipe`: reused where it is there and whole, otherwise made by `make(folder)`.

        A stage that fails or is interrupted leaves nothing under its key.
        """
        folder = self.workspace / recipe.stage / recipe.key
        if is_whole(folder, recipe):
            return Artifact(folder, recipe.key, reused=True)
        with self.alone(f"{recipe.stage}-{recipe.key}"):
            if is_whole(folder, recipe):  # another run has made it meanwhile
                return Artifact(folder, recipe.key, reused=True)
            try:
                self._make(recipe, make, folder)
            except Exception as error:
                if is_disk_full(error):
                    raise DiskFull(self.workspace) from error
                raise
        return Artifact(folder, recipe.key, reused=False)

    @contextmanager
    def alone(self, name: str) -> Iterator[None]:
        """What only one run at a time may do in this workspace; a run that is killed gives it up."""
        from filelock import FileLock, Timeout

        unfinished = self.workspace / _WORK
        unfinished.mkdir(parents=True, exist_ok=True)
        lock = FileLock(unfinished / f"{name}.lock")
        try:
            lock.acquire(timeout=PATIENCE_S)
        except Timeout:
            self._waiting()
            lock.acquire()
        try:
            yield
        finally:
            lock.release()

    def _make(self, recipe: Recipe, make: Callable[[Path], None], folder: Path) -> None:
        unfinished = self.workspace / _WORK
        _sweep(unfinished)
        work = Path(tempfile.mkdtemp(prefix=f"{recipe.stage}-", dir=unfinished))
        try:
            made = work / "made"
            made.mkdir()
            make(made)
            _write_manifest(made, recipe)
            _publish(made, folder, work / "replaced", recipe)
        finally:
            shutil.rmtree(work, ignore_errors=True)


def _sweep(unfinished: Path) -> None:
    """Remove what runs that were killed left behind."""
    for work in unfinished.iterdir():
        with suppress(OSError):
            if time.time() - work.stat().st_mtime <= STALE_S:
                continue
            if work.is_dir():
                shutil.rmtree(work, ignore_errors=True)
            else:
                work.unlink()


def is_whole(folder: Path, recipe: Recipe) -> bool:
    """Whether `folder` holds this recipe's artifact, with every file as it was written."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        listed = manifest.pop("files")
        there = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()} - {MANIFEST}
        return (
            manifest == json.loads(json.dumps(recipe.as_json()))
            and there == set(listed)
            and all(sha256_of(folder / name) == digest for name, digest in listed.items())
        )
    except (OSError, ValueError, KeyError, AttributeError, TypeError, RecursionError):
        return False


def _write_manifest(work: Path, recipe: Recipe) -> None:
    files = sorted(p for p in work.rglob("*") if p.is_file())
    digests = {p.relative_to(work).as_posix(): sha256_of(p) for p in files}
    (work / MANIFEST).write_text(json.dumps({**recipe.as_json(), "files": digests}, indent=1), encoding="utf-8")


def _publish(made: Path, folder: Path, aside: Path, recipe: Recipe) -> None:
    """Put the finished folder in its place in one step.

    A broken one there is moved aside first; where another run was faster, its whole folder stays.
    """
    for path in made.rglob("*"):
        if path.is_file():
            with path.open("r+b") as file:
                os.fsync(file.fileno())
    folder.parent.mkdir(parents=True, exist_ok=True)
    for _ in range(PUBLISH_TRIES):
        with suppress(FileNotFoundError):
            if folder.exists() and not is_whole(folder, recipe):
                folder.replace(aside)
        try:
            made.replace(folder)
            return
        except OSError:
            if is_whole(folder, recipe):
                return
    raise InputRefused(folder, "workspace", "cannot be written to", "check its permissions and free space")

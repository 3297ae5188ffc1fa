"""`WORKSPACE/<stage>/<key>/`: a stage's files with a manifest; the key covers all that they depend on."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bcid.store.code import Code

MANIFEST = "manifest.json"
_WORK = ".unfinished"


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

    def json(self, name: str) -> Any:
        """The content of one of its JSON files."""
        return json.loads((self.folder / name).read_text(encoding="utf-8"))


def sha256_of(path: Path) -> str:
    """Digest of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Store:
    """The artifacts of one workspace."""

    def __init__(self, workspace: Path) -> None:
        self.workspace = workspace

    def get(self, recipe: Recipe, make: Callable[[Path], None]) -> Artifact:
        """The artifact of `recipe`: reused where it is there and whole, otherwise made by `make(folder)`.

        A stage that fails or is interrupted leaves nothing under its key.
        """
        folder = self.workspace / recipe.stage / recipe.key
        if is_whole(folder, recipe):
            return Artifact(folder, recipe.key, reused=True)
        unfinished = self.workspace / _WORK
        unfinished.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f"{recipe.stage}-", dir=unfinished))
        try:
            make(work)
            _write_manifest(work, recipe)
            _publish(work, folder)
        finally:
            shutil.rmtree(work, ignore_errors=True)
            with suppress(OSError):
                unfinished.rmdir()
        return Artifact(folder, recipe.key, reused=False)


def is_whole(folder: Path, recipe: Recipe) -> bool:
    """Whether `folder` holds this recipe's artifact, with every file as it was written."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        listed = manifest.pop("files")
        return manifest == json.loads(json.dumps(recipe.as_json())) and all(
            sha256_of(folder / name) == digest for name, digest in listed.items()
        )
    except (OSError, ValueError, KeyError, AttributeError):
        return False


def _write_manifest(work: Path, recipe: Recipe) -> None:
    files = sorted(p for p in work.rglob("*") if p.is_file())
    digests = {p.relative_to(work).as_posix(): sha256_of(p) for p in files}
    (work / MANIFEST).write_text(json.dumps({**recipe.as_json(), "files": digests}, indent=1), encoding="utf-8")


def _publish(work: Path, folder: Path) -> None:
    """Put the finished folder in its place in one step; a broken or stale one makes way."""
    for path in work.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
    folder.parent.mkdir(parents=True, exist_ok=True)
    if folder.exists():
        shutil.rmtree(folder)
    work.replace(folder)

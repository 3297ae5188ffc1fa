"""Artifacts: folders `WORKSPACE/<stage>/<key>/` of a stage's files; a key covers all that they depend on."""

import hashlib
import json
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bcid.documents.manifest import ManifestDocument
from bcid.errors import DiskFull, InputRefused, is_disk_full
from bcid.files.limits import LIMITS
from bcid.files.outputs import explain_write_errors, flush_to_disk
from bcid.files.source_code import StageCode

MANIFEST = "manifest.json"
_UNFINISHED, _LOCKS = ".unfinished", ".locks"
# where artifacts are kept that somebody edited or added to, or that a disk damaged
_SET_ASIDE = "set_aside"
OTHER_WORKSPACE = 'name another with --out, or by workspace = "…" in the pipeline file'
# seconds of waiting after which a person is told that another run is at work
LOCK_NOTICE_S = 1.0
PUBLISH_TRIES = 3


@dataclass(frozen=True)
class Recipe:
    """All that an artifact depends on: stage, inputs, settings, code and seed."""

    stage: str
    inputs: Mapping[str, Any]  # by content: hashes of files, keys of other artifacts
    settings: Mapping[str, Any]
    code: StageCode
    seed: int | None = None

    def manifest(self, files: Mapping[str, str]) -> ManifestDocument:
        """The manifest of an artifact that was made so, with the SHA-256 of each of its `files`."""
        known = {
            "stage": self.stage, "inputs": dict(self.inputs), "settings": dict(self.settings),
            "code": self.code.digest, "packages": self.code.packages, "seed": self.seed, "files": dict(files),
        }  # fmt: skip
        # through JSON, as a manifest that is read back has been
        return ManifestDocument.model_validate_json(json.dumps(known, allow_nan=False))

    @property
    def key(self) -> str:
        """Name of the artifact's folder: a digest of the recipe in 20 hex digits."""
        text = json.dumps(self.manifest({}).as_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:20]


@dataclass(frozen=True)
class Artifact:
    """A finished artifact: its folder, its key, and whether it was there before."""

    folder: Path
    key: str
    reused: bool

    @property
    def content(self) -> str:
        """Digest of the artifact's files, whatever made them, for the keys of artifacts that depend on it."""
        files = ManifestDocument.read(self.folder / MANIFEST).files
        return hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest()[:20]

    def json(self, name: str) -> Any:
        """Parsed content of one of the artifact's JSON files."""
        return json.loads((self.folder / name).read_text(encoding="utf-8"))


def file_sha256(path: Path) -> str:
    """SHA-256 of the content of the file at `path`, in hex digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Store:
    """The artifacts of one workspace."""

    def __init__(
        self, workspace: Path, notify_waiting: Callable[[], None] = lambda: None,
        notify: Callable[[str], None] = lambda text: None,
    ) -> None:  # fmt: skip
        """Open the store in `workspace`; `notify_waiting` is called when another run keeps this one waiting.

        Where `notify_waiting` raises an error, that is raised in place of waiting.
        `notify` is called with a sentence where an artifact is set aside that is no longer as it was written.
        """
        self.workspace = workspace
        self._waiting, self._notify = notify_waiting, notify

    def get_or_make(self, recipe: Recipe, make: Callable[[Path], None]) -> Artifact:
        """Return the artifact of `recipe`, made by `make(folder)` unless it is there with every file as it was written.

        A stage that fails or is interrupted leaves nothing under its key.  What lies there and is not as it was
        written, since somebody edited it or a disk damaged it, is set aside and told.

        Raises:
            InputRefused: the workspace cannot be written to.
            DiskFull: the disk is full.
        """
        folder = self.workspace / recipe.stage / recipe.key
        if is_whole(folder, recipe):
            return Artifact(folder, recipe.key, reused=True)
        with self.exclusive_lock(f"{recipe.stage}-{recipe.key}"):
            if is_whole(folder, recipe):  # another run has made it meanwhile
                return Artifact(folder, recipe.key, reused=True)
            try:
                self._make_artifact(recipe, make, folder)
            except Exception as error:
                if is_disk_full(error):
                    raise DiskFull(self.workspace) from error
                raise
        return Artifact(folder, recipe.key, reused=False)

    @contextmanager
    def exclusive_lock(self, name: str) -> Iterator[None]:
        """Hold a lock that only one run at a time has in this workspace; the lock of a killed run is free."""
        from filelock import FileLock, Timeout

        locks = self.workspace / _LOCKS
        with explain_write_errors(self.workspace, OTHER_WORKSPACE):
            locks.mkdir(parents=True, exist_ok=True)
            # the file stays for good: whoever removed it might let two runs hold the lock, each on a file of its own
            lock = FileLock(locks / f"{name}.lock")
            try:
                lock.acquire(timeout=LOCK_NOTICE_S)
            except Timeout:
                self._waiting()
                lock.acquire()
        try:
            yield
        finally:
            lock.release()

    def _make_artifact(self, recipe: Recipe, make: Callable[[Path], None], folder: Path) -> None:
        """Make an artifact in a working folder, write its manifest, and move it to `folder`."""
        unfinished = self.workspace / _UNFINISHED
        with explain_write_errors(self.workspace, OTHER_WORKSPACE):
            unfinished.mkdir(parents=True, exist_ok=True)
            _remove_stale_work(unfinished)
            work = Path(tempfile.mkdtemp(prefix=f"{recipe.stage}-", dir=unfinished))
        try:
            made = work / "made"
            made.mkdir()
            make(made)
            files = sorted(p for p in made.rglob("*") if p.is_file())
            digests = {p.relative_to(made).as_posix(): file_sha256(p) for p in files}
            recipe.manifest(digests).write(made / MANIFEST)
            with explain_write_errors(self.workspace, OTHER_WORKSPACE):
                self._publish(made, folder, recipe)
        finally:
            shutil.rmtree(work, ignore_errors=True)

    def _publish(self, finished: Path, folder: Path, recipe: Recipe) -> None:
        """Move the `finished` artifact of `recipe` to `folder` in one step, after setting aside what is changed there.

        Where another run has published that artifact undamaged meanwhile, it stays.

        Raises:
            InputRefused: `folder` cannot be written to.
        """
        for path in finished.rglob("*"):
            if path.is_file():
                flush_to_disk(path)
        folder.parent.mkdir(parents=True, exist_ok=True)
        for _ in range(PUBLISH_TRIES):
            with suppress(FileNotFoundError):
                if folder.exists() and not is_whole(folder, recipe):
                    self._set_aside(folder)
            try:
                finished.replace(folder)
                return
            except OSError:
                if is_whole(folder, recipe):
                    return
        raise InputRefused(folder, "workspace", "cannot be written to", "check its permissions and free space")

    def _set_aside(self, folder: Path) -> None:
        """Move an artifact that is not as it was written out of the way, and say where it is kept."""
        home = self.workspace / _SET_ASIDE / folder.parent.name
        home.mkdir(parents=True, exist_ok=True)
        number = 1 + sum(1 for _ in home.glob(f"{folder.name}-*"))
        kept = folder.rename(home / f"{folder.name}-{number}")
        self._notify(f"{folder} was changed after it was written: it is made anew, what lay there is kept in {kept}")


def _remove_stale_work(unfinished: Path) -> None:
    """Remove working folders in `unfinished` that are older than any run lasts, left by killed runs."""
    for work in unfinished.iterdir():
        with suppress(OSError):
            if time.time() - work.stat().st_mtime > LIMITS.max_run_s:
                shutil.rmtree(work, ignore_errors=True)


def is_whole(folder: Path, recipe: Recipe) -> bool:
    """Whether `folder` holds the undamaged artifact of `recipe`: its manifest, and every file as it was written."""
    try:
        manifest = ManifestDocument.read(folder / MANIFEST)
        there = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()} - {MANIFEST}
        return (
            manifest == recipe.manifest(manifest.files)
            and there == set(manifest.files)
            and all(file_sha256(folder / name) == digest for name, digest in manifest.files.items())
        )
    except (OSError, InputRefused, RecursionError):
        return False

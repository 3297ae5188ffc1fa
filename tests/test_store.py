"""Artifacts: keys cover what they must, folders appear whole or not at all, damage is noticed."""

from __future__ import annotations

import errno
import json
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import pytest
from making import clear_source_caches

from bcid.errors import DiskFull
from bcid.files import source_code as code_module
from bcid.files.source_code import StageCode, import_closure, stage_code
from bcid.store.artifact import Recipe, Store, is_whole

CODE = StageCode("c0de", {"numpy": "2"})


def recipe(**changes: object) -> Recipe:
    given = {"stage": "fit", "inputs": {"a": "1"}, "settings": {"epochs": 3}, "code": CODE, "seed": 1}
    return Recipe(**{**given, **changes})  # type: ignore[arg-type]


def maker(text: str = "x") -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / "sub").mkdir()
        (folder / "sub" / "data.txt").write_text(text)

    return make


def never(folder: Path) -> None:
    raise AssertionError("made again")


@pytest.mark.parametrize(
    "changes",
    [
        {"stage": "tune"}, {"inputs": {"a": "2"}}, {"settings": {"epochs": 4}}, {"seed": 2},
        {"code": StageCode("other", {"numpy": "2"})}, {"code": StageCode("c0de", {"numpy": "3"})},
    ],
)  # fmt: skip
def test_every_part_of_a_recipe_is_in_its_key(changes: dict[str, object]) -> None:
    assert recipe(**changes).key != recipe().key
    assert recipe().key == recipe().key


def test_an_artifact_is_made_once(tmp_path: Path) -> None:
    store = Store(tmp_path)
    first = store.get_or_make(recipe(), maker())
    assert not first.reused
    again = store.get_or_make(recipe(), never)
    assert again.reused
    assert (again.folder / "sub" / "data.txt").read_text() == "x"
    manifest = json.loads((again.folder / "manifest.json").read_text())
    assert set(manifest["files"]) == {"sub/data.txt"}
    assert manifest["packages"] == {"numpy": "2"}


def test_a_stage_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fails(folder: Path) -> None:
        (folder / "half.txt").write_text("half")
        raise KeyboardInterrupt

    store = Store(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        store.get_or_make(recipe(), fails)
    assert [p for p in tmp_path.rglob("*") if p.is_file() and p.suffix != ".lock"] == []
    assert not store.get_or_make(recipe(), maker()).reused


@pytest.mark.parametrize("damage", ["flip", "remove", "manifest", "add key", "drop key", "odd key"])
def test_damage_is_noticed_and_made_good(damage: str, tmp_path: Path) -> None:
    store = Store(tmp_path)
    folder = store.get_or_make(recipe(), maker()).folder
    target = folder / "sub" / "data.txt"
    if damage == "flip":
        target.write_bytes(bytes([target.read_bytes()[0] ^ 1]))
    elif damage == "remove":
        target.unlink()
    elif damage == "manifest":
        (folder / "manifest.json").write_text("{")
    else:
        manifest = json.loads((folder / "manifest.json").read_text())
        seed = manifest.pop("seed")
        kept = {"add key": {"seed": 7}, "drop key": {}, "odd key": {"sded": seed}}[damage]
        (folder / "manifest.json").write_text(json.dumps({**manifest, **kept}))
    again = store.get_or_make(recipe(), maker())
    assert not again.reused
    assert target.read_text() == "x"
    assert store.get_or_make(recipe(), never).reused


def test_the_closure_reaches_what_is_called_from_afar() -> None:
    """The fit of a kinematic model runs the steering law, which it imports only through others."""
    modules = import_closure(["bcid.models.kinematic.k_mlp"])
    assert {
        "bcid.physics.steering",
        "bcid.physics.kinematics",
        "bcid.models.network.mlp",
        "bcid.compiled.njit",
    } <= modules
    assert "bcid.models.network.narx_mlp" not in modules
    assert not any(m.startswith(("bcid.cli", "bcid.report", "bcid.simulation")) for m in modules)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A small package in place of bcid's own: stage -> far -> law, with a comment to change."""
    root = tmp_path / "src"
    (root / "bcid").mkdir(parents=True)
    (root / "bcid" / "__init__.py").write_text("")
    (root / "bcid" / "stage.py").write_text("def make():\n    from bcid.far import f\n    return f()\n")
    (root / "bcid" / "far.py").write_text("from bcid import law\nimport numpy\n\ndef f():\n    return law.g()\n")
    (root / "bcid" / "law.py").write_text("def g():\n    return 1  # one\n")
    monkeypatch.setattr(code_module, "_ROOT", root)
    clear_source_caches()
    yield root / "bcid"
    clear_source_caches()


def test_editing_a_callee_changes_the_code_and_a_comment_does_not(package: Path) -> None:
    before = stage_code("bcid.stage")
    assert "numpy" in before.packages
    clear_source_caches()
    (package / "law.py").write_text("def g():\n    return 1  # still one\n")
    assert stage_code("bcid.stage") == before
    clear_source_caches()
    (package / "law.py").write_text("def g():\n    return 2\n")
    assert stage_code("bcid.stage").digest != before.digest


def test_a_template_beside_a_package_is_part_of_its_code(package: Path) -> None:
    before = stage_code("bcid.stage")
    clear_source_caches()
    (package / "page.html.j2").write_text("<p>")
    assert stage_code("bcid.stage").digest != before.digest


def test_what_was_parsed_is_kept_and_believed_only_as_it_was_written(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second process parses nothing; a damaged file, or a folder that cannot be written, costs time alone."""
    kept = tmp_path / "kept" / "syntax.json"

    def digest_anew(path: Path) -> str:
        clear_source_caches()
        monkeypatch.setattr(code_module, "_PARSED_FILES", code_module._ParsedFiles(path))
        return stage_code("bcid.stage").digest

    before = digest_anew(kept)
    written = kept.read_text()
    assert len(list(kept.parent.iterdir())) == 1
    for text in (written.replace('"numpy"', '"scipy"'), written[:-9], "", "0\n[1]"):
        kept.write_text(text)
        assert digest_anew(kept) == before
    assert kept.read_text() == written
    assert digest_anew(tmp_path / "src" / "bcid" / "law.py" / "syntax.json") == before  # in no folder
    monkeypatch.setattr(code_module, "_parse_source", None)
    assert digest_anew(kept) == before
    with pytest.raises(TypeError):
        digest_anew(tmp_path / "other.json")


def test_the_second_of_two_runs_waits_and_uses_what_the_first_made(tmp_path: Path) -> None:
    """And its person is told so."""
    begun, may_end, told = Event(), Event(), Event()

    def slowly(folder: Path) -> None:
        begun.set()
        assert may_end.wait(60.0)
        maker("first")(folder)

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(Store(tmp_path).get_or_make, recipe(), slowly)
        assert begun.wait(20.0)
        second = pool.submit(Store(tmp_path, told.set).get_or_make, recipe(), never)
        assert told.wait(20.0)
        may_end.set()
        assert not first.result(20.0).reused
        assert second.result(20.0).reused


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "x"), RuntimeError(f"I/O error: {os.strerror(errno.EFBIG)}")])
def test_a_full_disk_is_told_as_such_and_costs_nothing_that_is_finished(error: Exception, tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.get_or_make(recipe(), maker())

    def fails(folder: Path) -> None:
        (folder / "half.txt").write_text("half")
        raise error

    with pytest.raises(DiskFull, match="run again"):
        store.get_or_make(recipe(stage="tune"), fails)
    assert store.get_or_make(recipe(), never).reused
    assert not store.get_or_make(recipe(stage="tune"), maker()).reused


def test_every_flipped_bit_of_an_artifact_is_noticed(tmp_path: Path) -> None:
    """Each bit of a small artifact's files, its manifest's among them."""
    folder = Store(tmp_path).get_or_make(recipe(), maker("abc")).folder
    for path in (folder / "sub" / "data.txt", folder / "manifest.json"):
        whole = path.read_bytes()
        for bit in range(8 * len(whole)):
            flipped = bytearray(whole)
            flipped[bit // 8] ^= 1 << bit % 8
            path.write_bytes(bytes(flipped))
            assert not is_whole(folder, recipe()), (path.name, bit)
        path.write_bytes(whole)
    assert is_whole(folder, recipe())


def test_what_killed_runs_left_is_swept(tmp_path: Path) -> None:
    left = tmp_path / ".unfinished" / "fit-old"
    left.mkdir(parents=True)
    os.utime(left, (time.time() - 1e6, time.time() - 1e6))
    Store(tmp_path).get_or_make(recipe(), maker())
    assert not left.exists()


def test_a_lock_in_use_stays_however_old_its_file_is(tmp_path: Path) -> None:
    with Store(tmp_path).exclusive_lock("fit-held"):
        pass
    (file,) = tmp_path.rglob("fit-held.lock")
    for old in (file, file.parent):
        os.utime(old, (time.time() - 1e6, time.time() - 1e6))

    class Locked(Exception):
        """The lock is held."""

    def refuse() -> None:
        raise Locked

    with Store(tmp_path).exclusive_lock("fit-held"):
        Store(tmp_path).get_or_make(recipe(), maker())  # sweeps what killed runs left
        with pytest.raises(Locked), Store(tmp_path, refuse).exclusive_lock("fit-held"):
            pass

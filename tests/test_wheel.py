"""What is installed: every file of the package, nothing else, and what the wheel says of itself.

`python tests/try_wheel.py` installs and runs it.
"""

from __future__ import annotations

import tomllib
from configparser import ConfigParser
from zipfile import ZipFile

import pytest
from packaging.metadata import Metadata
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import parse_wheel_filename
from wheel_building import ROOT, build_wheel, copy_sources, package_files

import bcid

DIST_INFO = f"bcid-{bcid.__version__}.dist-info"
OWN_FILES = ("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE", "top_level.txt")
VERSIONS = ("3.11", "3.12", "3.13")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> ZipFile:
    pytest.importorskip("setuptools", reason="builds wheels; the extra dev has it")
    folder = tmp_path_factory.mktemp("wheel")
    path = build_wheel(copy_sources(folder / "sources"), folder)
    name, version, _, tags = parse_wheel_filename(path.name)
    assert (name, str(version), {str(tag) for tag in tags}) == ("bcid", bcid.__version__, {"py3-none-any"})
    return ZipFile(path)


def test_it_holds_every_file_of_the_package_and_nothing_else(wheel: ZipFile) -> None:
    """Templates, C sources and py.typed among them; no test, no sample log."""
    files = package_files()
    assert {"bcid/py.typed", "bcid/report/page.html.j2", "bcid/cli/templates/vehicle.toml"} <= files
    assert set(wheel.namelist()) == files | {f"{DIST_INFO}/{name}" for name in OWN_FILES}


def test_its_files_are_those_of_the_checkout(wheel: ZipFile) -> None:
    assert [name for name in package_files() if wheel.read(name) != (ROOT / name).read_bytes()] == []
    assert wheel.read(f"{DIST_INFO}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()


def test_it_says_what_it_is_and_needs(wheel: ZipFile) -> None:
    """Its metadata obey the standard, whose reader raises all that is wrong with them."""
    said = Metadata.from_email(wheel.read(f"{DIST_INFO}/METADATA"), validate=True)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (said.name, str(said.version), said.license_expression) == ("bcid", bcid.__version__, "MIT")
    assert said.description == (ROOT / "README.md").read_text(encoding="utf-8")
    assert said.description_content_type == "text/markdown"
    assert set(said.provides_extra or ()) == set(project["optional-dependencies"])
    needed = {r.name.lower() for r in said.requires_dist or () if r.marker is None}
    assert needed == {Requirement(text).name.lower() for text in project["dependencies"]}
    named = [text.partition("Python :: 3.") for text in said.classifiers or ()]
    stated = {f"3.{minor}" for _, found, minor in named if found}
    assert stated == set(VERSIONS)
    assert said.requires_python == SpecifierSet(f">={VERSIONS[0]}")


def test_it_brings_the_program(wheel: ZipFile) -> None:
    entries = ConfigParser()
    entries.read_string(wheel.read(f"{DIST_INFO}/entry_points.txt").decode())
    assert {section: dict(entries[section]) for section in entries.sections()} == {
        "console_scripts": {"bcid": "bcid.__main__:start"}
    }


def test_every_direct_dependency_has_its_exact_version() -> None:
    """Of the extras that `make test` installs, too."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [r for name, r in project["optional-dependencies"].items() if name != "bench"]
    pinned = {
        line.partition("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
        if "==" in line
    }
    asked = {Requirement(text).name.lower().replace("_", "-") for text in sum(extras, project["dependencies"])}
    assert sorted(asked - pinned) == []

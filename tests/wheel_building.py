"""A wheel of what is in this checkout, and what must be in it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "bcid")
"""What a wheel is built of.  It is copied first: leftovers in `build` would be put into the wheel, too."""

_BUILD = "import sys; from setuptools import build_meta; print(build_meta.build_wheel(sys.argv[1]))"


def copy_sources(folder: Path) -> Path:
    """Copy what a wheel is built of into the new folder `folder`, without what Python compiled; returns it."""
    folder.mkdir()
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(source, folder / name)
    return folder


def build_wheel(sources: Path, folder: Path) -> Path:
    """Build the wheel of `sources` into `folder` by the setuptools of this environment; returns its path."""
    words = [sys.executable, "-c", _BUILD, str(folder)]
    built = subprocess.run(words, cwd=sources, capture_output=True, text=True, check=True).stdout
    return folder / built.splitlines()[-1]


def package_files() -> set[str]:
    """Files of the package bcid in this checkout, by their path from its root, with /."""
    files = (path for path in (ROOT / "bcid").rglob("*") if path.is_file())
    return {path.relative_to(ROOT).as_posix() for path in files if "__pycache__" not in path.parts}

"""A row of a blind test on disk: whole, or not there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def keep(row: dict[str, Any], path: Path) -> None:
    """Write `row` to `path`; a run that is cut off leaves no half of it."""
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(row), encoding="utf-8")
    beside.replace(path)

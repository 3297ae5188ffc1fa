"""Every row of the catalogue of bad input: what is said, word for word but for its numbers.

`BCID_GOLDEN=write pytest tests/test_catalogue.py` writes the golden file anew; read its difference.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from catalogue import ROWS
from catalogue.lab import Lab

from bcid.errors import InputRefused
from bcid.recording.read import read_recording
from bcid.vehicle import Vehicle

GOLDEN = Path(__file__).parent / "catalogue" / "golden.json"
NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(e[+-]?\d+)?")
ELSEWHERE = {
    43: "test_mcap (memory)", 53: "test_store (stale and edited artifacts)",
}  # fmt: skip
"""Rows that are no recordings."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return Lab(tmp_path_factory.mktemp("catalogue"))


def said(lab: Lab, path: Path, vehicle: Vehicle) -> list[str]:
    """A refusal's four parts, or what is told beyond what the clean drive is told."""
    clean = lab.clean["mcap" if path.suffix in (".mcap", "") else "table" if vehicle.columns else "motive"]
    try:
        recording = read_recording(path, vehicle)
    except InputRefused as error:
        parts = (error.exit_code == InputRefused.exit_code, error.source, error.place, error.cause, error.next_step)
        if not all(parts):
            return ["a refusal that lacks a part", str(error)]
        text = str(error).replace(f"{lab.folder}/", "").replace(str(lab.folder), ".")
        return ["refused", *(NUMBER.sub("#", line) for line in text.split("\n"))]
    known = {(i.kind, i.action, i.count) for i in clean.irregularities}
    told = [i for i in recording.irregularities if (i.kind, i.action, i.count) not in known]
    return ["read", *(f"{i.action}: {i.kind}: {NUMBER.sub('#', i.detail)}" for i in told)]


def test_every_row_is_tried() -> None:
    assert {*ROWS, *ELSEWHERE} >= {*range(1, 55), *range(61, 66), *range(71, 77), *range(81, 89), *range(91, 95)}


@pytest.mark.parametrize("number", sorted(ROWS))
def test_what_is_said_of_a_row(number: int, lab: Lab) -> None:
    found = {label.strip(): said(lab, path, *(rest or [lab.vehicle])) for label, path, *rest in ROWS[number](lab)}
    golden = json.loads(GOLDEN.read_text(encoding="utf-8")) if GOLDEN.exists() else {}
    if os.environ.get("BCID_GOLDEN") == "write":
        golden[str(number)] = found
        text = json.dumps(dict(sorted(golden.items(), key=lambda item: int(item[0]))), indent=1, ensure_ascii=False)
        GOLDEN.write_text(text + "\n", encoding="utf-8")
    assert found == golden.get(str(number))

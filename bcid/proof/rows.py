"""Rows of a blind test on disk, all in one file that can be committed: each whole, or not there.

A row is kept under what was asked and the digest of the code that made it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bcid.diagnosis.diagnose import Diagnosis
from bcid.diagnosis.search.refits import corrections
from bcid.effects.table import EFFECTS
from bcid.files.source_code import code_of

ROWS = "rows.jsonl"


def digest_of(modules: Iterable[str]) -> str:
    """Of the code of some modules, with all that they import, and of the libraries' versions."""
    text = repr([(c.digest, sorted(c.packages.items())) for c in map(code_of, modules)])
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def keep(row: dict[str, Any], key: str, folder: Path) -> None:
    """Add `row` to those in `folder`, as a line of its own; several processes of one machine may do so.

    A line that a run which was cut off left unfinished is ended first, so that it spoils no other.
    """
    line = json.dumps({"key": key, "row": row}).encode() + b"\n"
    with (folder / ROWS).open("a+b", buffering=0) as file:
        if file.tell():
            file.seek(-1, os.SEEK_END)
            line = line if file.read(1) == b"\n" else b"\n" + line
        while line:
            line = line[file.write(line) :]


def written(folder: Path) -> int:
    """How many rows have been written into `folder`, each time that one was."""
    path = folder / ROWS
    return path.read_bytes().count(b"\n") if path.is_file() else 0


def kept(folder: Path) -> dict[str, dict[str, Any]]:
    """All rows in `folder` by their keys; unfinished lines hold none, and what ended in an error replaces nothing."""
    rows = dict[str, dict[str, Any]]()
    path = folder / ROWS
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        try:
            entry = json.loads(line)
            key, row = entry["key"], entry["row"]
        except (ValueError, KeyError, TypeError):
            continue
        if isinstance(row, dict) and not ("error" in row and key in rows):
            rows[key] = row
    return rows


def said(found: Diagnosis) -> dict[str, Any]:
    """Verdict, findings, and what is located, left and not excited, as JSON holds it."""
    judgement, location = found.judgement, found.location
    left, place, window = judgement.left.remainder, location.place, location.window
    return {
        "verdict": judgement.verdict,
        "findings": [
            {
                "effect": f.effect, "kind": EFFECTS[f.effect].kind, "twins": list(f.twins),
                "probability": round(f.probability, 4), "gain": round(f.gain, 1), "heldout": round(f.heldout.nats, 1),
                "values": {k: list(v) for k, v in f.values.items()},
            }
            for f in judgement.findings
        ],
        "dropped": list(judgement.dropped),
        "corrections": list(corrections(judgement.fit)),
        "remainder": {
            "channel": judgement.left.channel, "entering": judgement.left.entering, "correlations": left.correlations,
            "gain": round(left.gain, 1), "nats": round(judgement.nats_left, 1),
            "lying": {way.channel: round(way.nats, 1) for way in judgement.left.lying},
        },
        "located": location.channel,
        "place": [place.x, place.y, place.radius] if place else None,
        "window": [window.begin_s, window.end_s] if window else None,
        "p_value": found.p_value,
        "not_excited": {u.effect: u.smallest for u in found.unexcited},
    }  # fmt: skip

"""Rows of a proof: what is kept of one diagnosis, and the file of rows, each line whole or ignored.

A row is stored under a key that holds what was asked and the digest of the code that made the row.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bcid.diagnosis.diagnose import Diagnosis
from bcid.diagnosis.search.refits import fitted_corrections
from bcid.effects.table import EFFECTS
from bcid.files.source_code import stage_code

ROWS_FILE = "rows.jsonl"


def code_digest(modules: Iterable[str]) -> str:
    """Digest (12 hex digits) of the code of `modules`, of all project modules they import, and of library versions."""
    text = repr([(c.digest, sorted(c.packages.items())) for c in map(stage_code, modules)])
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def append_row(row: dict[str, Any], key: str, folder: Path) -> None:
    """Append a row (the stored result of one case, as JSON) under its `key` to the file rows.jsonl in `folder`.

    Several processes on one machine may append at once.  If the last line is incomplete, because a run was
    interrupted, a line break is written first.
    """
    line = json.dumps({"key": key, "row": row}).encode() + b"\n"
    with (folder / ROWS_FILE).open("a+b", buffering=0) as file:
        if file.tell():
            file.seek(-1, os.SEEK_END)
            line = line if file.read(1) == b"\n" else b"\n" + line
        while line:
            line = line[file.write(line) :]


def count_written_rows(folder: Path) -> int:
    """Number of lines in the file rows.jsonl in `folder`, with repeated and failed results; 0 if there is no file."""
    path = folder / ROWS_FILE
    return path.read_bytes().count(b"\n") if path.is_file() else 0


def read_rows(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the stored results of cases (rows) in `folder`, by key; of several under one key, the last.

    A row with an "error" does not replace one without.  Incomplete lines are skipped; without a file the dict is
    empty.
    """
    rows = dict[str, dict[str, Any]]()
    path = folder / ROWS_FILE
    for line in path.read_bytes().splitlines() if path.is_file() else ():
        try:
            entry = json.loads(line)
            key, row = entry["key"], entry["row"]
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
        if isinstance(key, str) and isinstance(row, dict) and not ("error" in row and key in rows):
            rows[key] = row
    return rows


def diagnosis_row(diagnosis: Diagnosis) -> dict[str, Any]:
    """The parts of a diagnosis that are stored and scored, as a JSON object (row).

    "verdict"; "other_figures" of a simulation, each with "symbol" and "nats"; "findings", each with "effect", "kind",
    "twins" (effects that cannot be told from it), "probability" and "values" with standard errors; "remainder", what
    stays unexplained; "located", "place" and "window", the channel, circle on the floor and time window of the
    mismatch; "p_value" of a perfect base model; "not_excited", the smallest detectable size of each effect that the
    drive could not show.
    """
    judgement, location, naming = diagnosis.judgement, diagnosis.location, diagnosis.naming
    place, window, left = location.place, location.window, naming.rest.seen.channel_nats()
    return {
        "verdict": judgement.verdict,
        "findings": [
            {
                "effect": f.effect, "kind": EFFECTS[f.effect].kind, "twins": list(f.twins),
                "probability": round(f.probability, 4), "gain": round(f.gain_nats, 1),
                "heldout": round(f.held_out.nats, 1),
                "values": {k: list(v) for k, v in f.values.items()},
            }
            for f in judgement.findings
        ],
        "other_figures": [f._asdict() for f in diagnosis.other_figures],
        "dropped": {name: round(nats, 1) for name, nats in naming.dropped.items()},
        "corrections": list(fitted_corrections(diagnosis.fit)),
        "gate": round(naming.nulls.gate, 1),
        "remainder": {
            "channel": next(iter(left), None), "entering": {c: round(nats, 1) for c, nats in left.items()},
            "nats": round(naming.rest.nats, 1), "before": round(naming.before.nats, 1),
        },
        "located": location.channel,
        "place": [place.x, place.y, place.radius] if place else None,
        "window": [window.begin_s, window.end_s] if window else None,
        "p_value": diagnosis.p_value,
        "not_excited": {
            u.effect: u.smallest_detectable.value if u.smallest_detectable else None for u in diagnosis.not_excited
        },
    }  # fmt: skip

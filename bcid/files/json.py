"""JSON files that carry a digest of their content: a flipped bit or a careless edit is noticed wherever they go."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

DIGEST = "sha256"
MAX_BYTES = 1 << 26  # of a file; a model of ours has some hundred thousand


def _digest(data: dict[str, Any]) -> str:
    text = json.dumps({k: v for k, v in data.items() if k != DIGEST}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write `data` with its digest."""
    # through JSON once, since what is read back (lists for tuples) is what the digest must be of
    whole = json.loads(json.dumps(data))
    path.write_text(json.dumps({**whole, DIGEST: _digest(whole)}, indent=1, ensure_ascii=False), encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """What `write_json` has written; a file without a digest is taken as it is.

    Raises:
        OSError: it cannot be read.
        ValueError: too large, no JSON object, or not as it was written.
    """
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"has {path.stat().st_size} bytes, {MAX_BYTES} are the most")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    if not isinstance(data, dict):
        raise ValueError("is no JSON object")
    stated = data.pop(DIGEST, None)
    if stated is not None and stated != _digest(data):
        raise ValueError(f"is not as it was saved: its digest differs (remove {DIGEST!r} to keep an edit)")
    return data

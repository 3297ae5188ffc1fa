"""JSON files that carry a digest of their content: a flipped bit or a careless edit is noticed wherever they go."""

import hashlib
import json
from pathlib import Path
from typing import Any

from bcid.files.limits import LIMITS
from bcid.files.regular import read_regular_file

DIGEST = "sha256"


def _content_digest(data: dict[str, Any]) -> str:
    """SHA-256 in hex digits of `data` as canonical JSON, without the entry that holds such a digest."""
    text = json.dumps({k: v for k, v in data.items() if k != DIGEST}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write `data` as a JSON file with a digest of its content as a further entry, which `read_json` checks."""
    # through JSON once, since what is read back (lists for tuples) is what the digest must be of
    whole = json.loads(json.dumps(data))
    text = json.dumps({**whole, DIGEST: _content_digest(whole)}, indent=1, ensure_ascii=False)
    path.write_text(text, encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in the file at `path`; a digest of its content that it carries is checked and taken out.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no regular file of at most LIMITS.max_json_bytes, holds no JSON object or text that is not
            Unicode, or differs from its digest.
    """
    text = read_regular_file(path, LIMITS.max_json_bytes).decode("utf-8")
    try:
        data = json.loads(text)
        if not isinstance(data, dict):
            raise ValueError("is no JSON object")
        stated = data.pop(DIGEST, None)
        if stated is not None and stated != _content_digest(data):
            raise ValueError(f"is not as it was saved: its digest differs (remove {DIGEST!r} to keep an edit)")
        # half a surrogate pair can be escaped in JSON, but written to no file
        json.dumps(data, ensure_ascii=False).encode("utf-8")
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    return data

"""`python tests/compare_results.py BEFORE AFTER`: are the figures of two runs the same to the last digit?

BEFORE and AFTER are folders with any of report.json, diagnosis.json and rows.jsonl (of a blind test).  Times, versions
and digests are left out, by the names of their fields; fields that only AFTER has are named.  Ends with exit code 1
where a figure differs or a file is missing in AFTER.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

LEFT_OUT = {"rollout_ms", "machine", "seconds", "code", "key", "versions", "sha256"}


def leaves(value: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """Every figure and word of a JSON value, with its place."""
    if isinstance(value, dict):
        for k, v in value.items():
            if k not in LEFT_OUT:
                yield from leaves(v, f"{at}/{k}")
    elif isinstance(value, list):
        yield f"{at}#", len(value)
        for i, v in enumerate(value):
            yield from leaves(v, f"{at}/{i}")
    else:
        yield at, value


def read(path: Path) -> Any:
    """The content of a JSON file, or the rows of a blind test by their case."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return json.loads(text)
    entries = [json.loads(line) for line in text.splitlines()]
    return {entry["key"].partition(".")[0]: entry["row"] for entry in entries}  # less the code that made it


def compare(before: Path, after: Path) -> bool:
    """Print how two files compare; whether every figure of the first is in the second."""
    if not after.is_file():
        print(f"{before.name}: missing in {after.parent}")  # noqa: T201
        return False
    old, new = dict(leaves(read(before))), dict(leaves(read(after)))
    differ = [(k, v, new.get(k, "absent")) for k, v in old.items() if k not in new or new[k] != v]
    added = sorted({k.split("/")[1] if "/" in k else k for k in new.keys() - old.keys() if new[k] is not None})
    print(f"{before.name}: {len(old)} figures and words, {len(differ)} differ; added: {', '.join(added) or 'none'}")  # noqa: T201
    for place, was, now in differ[:20]:
        print(f"  {place}: {was!r} -> {now!r}")  # noqa: T201
    return not differ


if __name__ == "__main__":
    folders = Path(sys.argv[1]), Path(sys.argv[2])
    files = [f for f in ("report.json", "diagnosis.json", "rows.jsonl") if (folders[0] / f).is_file()]
    same = [compare(folders[0] / f, folders[1] / f) for f in files]
    sys.exit(0 if files and all(same) else 1)

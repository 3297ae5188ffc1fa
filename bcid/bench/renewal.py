"""Some rows of a speed benchmark's JSON timed anew, beside the others as they were."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bcid.bench.run import HOT_PATHS, SCHEMA, list_missed
from bcid.errors import InputRefused
from bcid.files.json import read_json

TIME_ALL = "time all paths: leave --only and --renew out"


def read_timings(path: Path) -> dict[str, Any]:
    """The JSON of an earlier `bcid bench speed --out` in the file at `path`.

    Raises:
        InputRefused: the file cannot be read, or holds something else.
    """
    try:
        earlier = read_json(path)
    except (OSError, ValueError) as error:
        raise InputRefused(path, "timings", str(error), TIME_ALL) from None
    rows = [row for key in ("rows", "skipped") for row in earlier.get(key, [None])]
    if earlier.get("schema") != SCHEMA or not all(
        isinstance(row, dict) and row.get("only") in HOT_PATHS for row in rows
    ):
        raise InputRefused(path, "timings", f"no rows of {SCHEMA} that each say what --only names them", TIME_ALL)
    return earlier


def renew_timings(earlier: dict[str, Any], now: dict[str, Any], names: Sequence[str], path: Path) -> dict[str, Any]:
    """The timings `earlier`, in which those of the hot paths `names` are replaced by those timed `now`.

    Rows come in the order of HOT_PATHS.  A library that this process has not imported keeps the version by which it
    was timed.

    Raises:
        InputRefused: the rows do not belong in one table: another machine, number of turns, or version of a library
            that was used.  `path` is the file of the timings `earlier`.
    """
    for key, what in (("machine", "the machine"), ("repeats", "the number of turns (--repeats)")):
        if earlier[key] != now[key]:
            raise InputRefused(path, key, f"{what} was {earlier[key]}, and is {now[key]}", TIME_ALL)
    used = {name: version for name, version in now["versions"].items() if name in sys.modules}
    stated = earlier["versions"]
    for name, version in used.items():
        if stated.get(name) not in (None, version):
            raise InputRefused(path, f"versions.{name}", f"was {stated[name]}, and is {version}", TIME_ALL)
    order = list(HOT_PATHS)
    both = {
        key: sorted(
            [*(row for row in earlier[key] if row["only"] not in names), *now[key]],
            key=lambda row: order.index(row["only"]),
        )
        for key in ("rows", "skipped")
    }
    return earlier | both | {"versions": now["versions"] | stated | used, "missed": list_missed(both["rows"])}

"""Every field of everything that is saved, edited with digests made right, loaded and driven in a watched process.

What may come of an edit: it is refused by name, or what is driven stays the same, or is of other finite numbers.
"""

from __future__ import annotations

import resource
import shutil
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcid.errors import BcidError, PredictionDiverged, UsageError
from bcid.models.interface import RolloutDiverged
from faults.saved import Saved, saved_things

HANG_S = 10.0
MORE_MIB = 250.0  # that one edit may need beyond what all before it did
FAILURES = ("internal error", "crash", "hang", "memory", "not finite", "not named")


class Outcome(NamedTuple):
    """What came of one edit."""

    kind: str
    number: int
    field: str
    how: str
    what: str
    text: str = ""


def choose(count: int, most: int | None, seed: int = 7) -> list[int]:
    """Numbers of the edits that are tried: all, or `most` of them, the same every time."""
    if most is None or most >= count:
        return list(range(count))
    return sorted(np.random.default_rng([seed, count]).choice(count, most, replace=False).tolist())


def run_battery(most: int | None = None, only: str | None = None) -> Iterator[Outcome]:
    """Outcomes of the edits of every kind, or of those whose name holds `only`; `most` edits of each kind."""
    context, done = get_context("spawn"), set[tuple[str, int]]()
    while True:
        ours, theirs = context.Pipe(duplex=False)
        child = context.Process(target=_work, args=(theirs, most, only, frozenset(done)))
        child.start()
        theirs.close()
        begun: Outcome | None = None
        ended = False
        while not ended:
            try:
                if begun is not None and not ours.poll(HANG_S):
                    child.kill()
                    done.add((begun.kind, begun.number))
                    yield begun._replace(what="hang")
                    break
                message = ours.recv()
            except EOFError:
                child.join()
                if begun is None:
                    raise RuntimeError(f"the battery's process ended with {child.exitcode}") from None
                done.add((begun.kind, begun.number))
                yield begun._replace(what="crash", text=f"exit code {child.exitcode}")
                break
            if message is None:
                ended = True
            elif message.what == "begun":
                begun = message
            else:
                done.add((message.kind, message.number))
                begun = None
                yield message
        child.join()
        if ended:
            return


def _work(pipe: Connection, most: int | None, only: str | None, done: frozenset[tuple[str, int]]) -> None:
    """Try all edits that are not `done`; tell before each what begins and after it what came of it."""
    with tempfile.TemporaryDirectory() as home:
        for kind in saved_things(Path(home)):
            if only is not None and only not in kind.name:
                continue
            edits = kind.edits()
            numbers = [n for n in choose(len(edits), most) if (kind.name, n) not in done]
            clean, whole = kind.use(), {p: p.read_bytes() for p in kind.folder.rglob("*") if p.is_file()}
            for number in numbers:
                edit = edits[number]
                about = Outcome(kind.name, number, edit.field, edit.how, "begun")
                pipe.send(about)
                edit.write(kind.path)
                what, text = outcome(kind, clean, edit.field)
                pipe.send(about._replace(what=what, text=text))
                _put_back(kind.folder, whole)
    pipe.send(None)


def _put_back(folder: Path, whole: dict[Path, bytes]) -> None:
    if not folder.exists():
        folder.mkdir(parents=True)
    for path in folder.rglob("*"):
        if path.is_file() and path not in whole:
            path.unlink()
    for path, content in whole.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    shutil.rmtree(folder.parent / "out", ignore_errors=True)


def outcome(kind: Saved, clean: Any, field: str) -> tuple[str, str]:
    """What using the edited file comes to, beside what the clean one gives; with a text where it failed."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    try:
        used = kind.use()
    except BcidError as error:
        named = isinstance(error, UsageError) or _is_named(str(error), kind, field)
        return "refused" if named else "not named", str(error)
    except (RolloutDiverged, PredictionDiverged):
        return "diverges, which is told", ""
    except Exception:
        return "internal error", traceback.format_exc()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if peak > before + MORE_MIB:
        return "memory", f"{peak - before:.0f} MiB more"
    same = all(np.array_equal(used[k], clean[k]) for k in clean)
    if not all(np.isfinite(v).all() for v in used.values() if isinstance(v, np.ndarray)):
        return "not finite", ""
    return ("the same" if same else "changed"), ""


def _is_named(message: str, kind: Saved, field: str) -> bool:
    """Whether a refusal names a next step, and the edited folder, a field of it, or the take that is in it."""
    return "next: " in message and any(w in message for w in (*field.split("."), str(kind.folder), "drive.csv"))


def count(outcomes: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """How often each outcome came of the edits of each kind."""
    kinds = dict.fromkeys(o.kind for o in outcomes)
    return {k: dict(Counter(o.what for o in outcomes if o.kind == k)) for k in kinds}

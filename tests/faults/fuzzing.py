"""Mutants of every kind of file, read in turn: what is refused, what is read, and what must not be."""

from __future__ import annotations

import resource
import signal
import tempfile
import traceback
import zlib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcid.errors import BcidError
from bcid.recording.read import UnforeseenContent
from faults.specimens import Specimen, specimens

HANG_S = 10
BATCH = 250
MAX_PEAK_MIB = 600
FAILURES = ("traceback", "hang", "wrong", "silent loss", "memory")
UNFORESEEN = "unforeseen"


class Hang(Exception):
    """Reading takes too long."""


@contextmanager
def _in_time() -> Iterator[None]:
    def late(*_: Any) -> None:
        raise Hang

    signal.signal(signal.SIGALRM, late)
    signal.alarm(HANG_S)
    try:
        yield
    finally:
        signal.alarm(0)


def mutant(specimen: Specimen, clean: bytes, number: int) -> tuple[str, bytes]:
    """The mutator's name and the mutant of this number: the same every time, and never the clean file."""
    rng = np.random.default_rng([zlib.crc32(specimen.name.encode()), number])
    while True:
        mutate = specimen.mutators[int(rng.integers(len(specimen.mutators)))]
        data = mutate(clean, rng)
        if data != clean:
            return mutate.__name__, data


def outcome(specimen: Specimen, clean: Any, shorter: bool) -> tuple[str, str]:
    """What reading the specimen's file comes to, beside what the clean one gives; with a text where it failed.

    A table that is cut at a line's end is a `shorter` table, of which nothing says that it was longer.
    """
    try:
        with _in_time():
            found = specimen.read()
    except UnforeseenContent:
        return UNFORESEEN, traceback.format_exc()
    except BcidError:
        return "refused", ""
    except Hang:
        return "hang", ""
    except Exception:
        return "traceback", traceback.format_exc()
    if isinstance(found, dict) and not found.get("sound", True):
        return "wrong", "numbers that nothing can have"
    if specimen.verified and found["content"] != clean["content"]:
        return "wrong", ""
    if specimen.salvaged and found["vouched"] and not found["rows"] <= clean["rows"]:
        return "wrong", f"{len(found['rows'] - clean['rows'])} rows were never written"
    if isinstance(found, dict) and "samples" in found:
        if found["samples"] < clean["samples"] and found["told"] == clean["told"] and not shorter:
            return "silent loss", f"{clean['samples']} -> {found['samples']}"
        return ("read, the same" if found["content"] == clean["content"] else "read, changed"), ""
    return "read", ""


class Batch(NamedTuple):
    """Mutants of one kind."""

    kind: str
    first: int
    count: int


def run_batch(batch: Batch) -> tuple[str, Counter[str], list[dict[str, Any]], float]:
    """Outcomes by name, the failures with what repeats them, and the process's peak memory in MiB."""
    with tempfile.TemporaryDirectory() as folder:
        specimen = next(s for s in specimens(Path(folder)) if s.name == batch.kind)
        clean_bytes, clean = specimen.path.read_bytes(), specimen.read()
        counts: Counter[str] = Counter()
        failures = []
        for number in range(batch.first, batch.first + batch.count):
            how, data = mutant(specimen, clean_bytes, number)
            specimen.path.write_bytes(data)
            cut = specimen.name == "table CSV" and clean_bytes.startswith(data) and data.endswith(b"\n")
            what, text = outcome(specimen, clean, cut)
            # refused all the same, by the guard around all readers
            counts["refused" if what == UNFORESEEN else what] += 1
            if what == UNFORESEEN:
                counts[UNFORESEEN] += 1
            if what in FAILURES:
                failures.append({"kind": batch.kind, "number": number, "mutator": how, "outcome": what, "text": text})
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return batch.kind, counts, failures, peak


def kinds() -> list[str]:
    """The names of all kinds."""
    with tempfile.TemporaryDirectory() as folder:
        return [s.name for s in specimens(Path(folder))]


def fuzz(
    n: int, workers: int, only: str | None = None
) -> Iterator[tuple[str, Counter[str], list[dict[str, Any]], float]]:
    """`n` mutants of every kind, in batches as they end."""
    names = [k for k in kinds() if only is None or only in k]
    batches = [Batch(k, first, min(BATCH, n - first)) for k in names for first in range(0, n, BATCH)]
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        for batch, (kind, counts, failures, peak) in zip(batches, pool.map(run_batch, batches), strict=True):
            # in a process of its own, which has read nothing else
            if peak > MAX_PEAK_MIB:
                counts["memory"] += 1
                failed = {"kind": kind, "number": batch.first, "mutator": "", "outcome": "memory"}
                failures.append({**failed, "text": f"{peak:.0f} MiB"})
            yield kind, counts, failures, peak

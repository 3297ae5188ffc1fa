"""Limits halved and doubled over a panel of takes: verdicts are stored as rows, and those that change are counted."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bcid.diagnosis.limits import DECIDING_LIMITS
from bcid.documents.varied_limits import VariedLimitsDocument
from bcid.execution.jobs import run_jobs
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.limit_panel import EXAMPLE
from bcid.proof.blind.varied_take import FACTORS, Variation, list_variations, tell_variations
from bcid.proof.rows import append_row, code_digest, read_rows
from bcid.proof.scores.limit_changes import VariedRow, count_changes

ROW_MODULES = ("bcid.simulation.drive", "bcid.simulation.room_drive", "bcid.proof.blind.varied_take")
"""Modules whose code, with all that they import, decides what a row holds."""


def vary_limits(
    panel: Sequence[BlindCase], seed: int, folder: Path, workers: int = 1, minutes: float | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> VariedLimitsDocument:  # fmt: skip
    """Tell each take of a `panel` its verdict with every deciding limit halved and doubled; count those that change.

    Verdicts are stored in `folder` under digests of the case and of the code, limit and change, and those that
    are there are not told again.  None begins after so many `minutes`.  `seed` is that of the panel.  `progress` is
    called with the number of takes that have ended.
    """
    folder.mkdir(parents=True, exist_ok=True)
    code, variations = code_digest(ROW_MODULES), list_variations()
    stored = read_rows(folder)
    missing = {
        case.digest(): [v for v in variations if "error" in stored.get(_row_key(case, v, code), {"error": "none"})]
        for case in panel
    }
    # unrelated to tiers, so that an unfinished run has some of each
    todo = sorted((case for case in panel if missing[case.digest()]), key=lambda case: case.digest())
    end = np.inf if minutes is None else time.time() + 60.0 * minutes

    def prepare(case: BlindCase) -> Callable[[], None] | None:
        in_time = time.time() < end
        return partial(_tell_and_store, case, missing[case.digest()], code, folder, end) if in_time else None

    for done, _ in enumerate(run_jobs(todo, prepare, workers), len(panel) - len(todo) + 1):
        progress(done)
    about = {"seed": seed, "code": code, "takes": len(panel), "tiers": dict(Counter(case.tier for case in panel))}
    values = {name: {change: Variation(name, change).value for change in ("", *FACTORS)} for name in DECIDING_LIMITS}
    return count_changes(_collect_rows(panel, read_rows(folder), code), values, about, EXAMPLE.name)


def _tell_and_store(case: BlindCase, variations: Sequence[Variation], code: str, folder: Path, end: float) -> None:
    """Tell a case's verdict with each of the `variations`, and store them; none begins after the time `end`."""
    tell_variations(
        case, variations, lambda variation, row: append_row(row, _row_key(case, variation, code), folder),
        lambda: time.time() < end,
    )  # fmt: skip


def _row_key(case: BlindCase, variation: Variation, code: str) -> str:
    """Key of a stored verdict: digest of the case, digest `code` of the code, limit, and whether halved or doubled."""
    return ".".join([case.digest(), code, "limits", *filter(None, variation)])


def _collect_rows(panel: Sequence[BlindCase], stored: Mapping[str, dict[str, Any]], code: str) -> list[VariedRow]:
    """The verdicts of a panel that are stored under this `code`."""
    return [
        VariedRow(case.name, ", ".join(case.answer), *variation, stored[key])
        for case in panel
        for variation in list_variations()
        if (key := _row_key(case, variation, code)) in stored
    ]

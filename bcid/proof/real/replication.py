"""Whether two drives of one day show the same: names, and sizes within their standard errors, or told as changed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.proof.real.limits import LIMITS
from bcid.proof.real.question_files import QuestionInputs, reference_from_row
from bcid.proof.real.questions import DrivePair
from bcid.proof.rows import diagnosis_row


def compare_drives(
    pair: DrivePair, inputs: QuestionInputs, first: Mapping[str, Any], second: Mapping[str, Any]
) -> dict[str, Any]:
    """Compare what two drives of one day show, each diagnosed alone; the row of a pair of drives.

    `first` and `second` are rows of `diagnose_drive`, freely diagnosed.  The row has "named" (how many names either
    gives), "only" (names that one of the two shows, by "first" and "second"), "sizes" (`compare_sizes`), and "changed":
    the effects of which the second drive is told to have another size than the first one's model, if a size differs.
    """
    mine, theirs = (_names_and_twins(row["findings"]) for row in (first, second))
    sizes = compare_sizes(first["findings"], second["findings"])
    changed = [] if all(size["same"] for size in sizes) else _changed_effects(pair, inputs, first)
    return {
        "verdict": "compared", "findings": [], "named": [len(mine), len(theirs)], "sizes": sizes, "changed": changed,
        "only": {
            "first": [names[0] for names in mine if not _meets_any(names, theirs)],
            "second": [names[0] for names in theirs if not _meets_any(names, mine)],
        },
    }  # fmt: skip


def compare_sizes(first: Sequence[Mapping[str, Any]], second: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The parameters of the effects that two diagnoses' findings name both, and whether they are of one size.

    Each has "effect", "symbol", "first" and "second" (value and standard error), and "same": they differ by at most
    `LIMITS.same_size_se` standard errors of the difference.
    """
    theirs, rows = {f["effect"]: f["values"] for f in second}, list[dict[str, Any]]()
    for finding in first:
        for symbol, (value, se) in finding["values"].items():
            if symbol not in theirs.get(finding["effect"], ()):
                continue
            other, other_se = theirs[finding["effect"]][symbol]
            same = abs(value - other) <= LIMITS.same_size_se * math.hypot(se, other_se)
            rows.append({
                "effect": finding["effect"], "symbol": symbol, "first": [value, se], "second": [other, other_se],
                "same": same,
            })  # fmt: skip
    return rows


def _changed_effects(pair: DrivePair, inputs: QuestionInputs, first: Mapping[str, Any]) -> list[str]:
    """The effects of the first drive's model whose size a diagnosis of the second against it tells to be another."""
    vehicle = inputs.vehicle_for(pair.test)
    recording, estimate, _ = inputs.estimate_recording(pair.test, vehicle)
    model = reference_from_row(first["model"])
    assert model is not None  # noqa: S101  # a diagnosis has one
    known = model._replace(relative_sd=LIMITS.unedited_relative_sd)
    row = diagnosis_row(diagnose_recordings([recording], [estimate], vehicle, known))
    return effects_of_figures(row)


def effects_of_figures(row: Mapping[str, Any]) -> list[str]:
    """The effects of a simulation of which a diagnosis's row tells that a figure is another one, each once."""
    symbols = [figure["symbol"] for figure in row["other_figures"]]
    return list(dict.fromkeys(s.partition("__")[0] for s in symbols if "__" in s))


def _names_and_twins(findings: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """The name of each finding, with what cannot be told from it."""
    return [(f["effect"], *f["twins"]) for f in findings]


def _meets_any(names: tuple[str, ...], others: Sequence[tuple[str, ...]]) -> bool:
    """Whether one of the `names` is among those of any other finding."""
    return any(set(names) & set(other) for other in others)

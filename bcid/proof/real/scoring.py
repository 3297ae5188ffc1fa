"""Scores of the answers to questions about real recordings; rows outlive a change of what counts as right.

A scored row has "tier", "recording", "case", "right", and "false": names that nothing excuses.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bcid.effects.table import EFFECTS
from bcid.proof.limits import LIMITS
from bcid.proof.real.jobs import Job
from bcid.proof.real.misfit import own_quantity
from bcid.proof.real.questions import DrivePair, EditedQuestion, RecordedDrive, WithheldQuestion
from bcid.proof.real.transfer import AUGMENTED, BASE, NAMED
from bcid.proof.real.variations import AS_ASKED

TIERS = ("withheld", "control", "edited", "replication", "transfer", "start", "part")
"""Kinds of rows.

"withheld" has an answer; "control" has none, as nothing is withheld, the tracking fails, or what is withheld or edited
does not show; "start" and "part" are questions asked once more.
"""

Row = dict[str, Any]


def score_jobs(jobs: Iterable[Job], rows: Mapping[str, Mapping[str, Any]]) -> list[Row]:
    """The scored rows of all jobs that answer a question and have a row in `rows` (by key), by tier and name.

    A row whose question was asked once more has "changes_with": the variations that had another answer.
    """
    done = [job for job in jobs if job.question is not None and job.key in rows]
    scored = {job.key: score_job(job, rows) for job in done}
    for job in done:
        row = scored[job.key]
        if job.variation != AS_ASKED and row["differs"] and job.beside[0] in scored:
            scored[job.beside[0]].setdefault("changes_with", []).append(job.variation.name)
    return sorted(scored.values(), key=lambda row: (TIERS.index(row["tier"]), row["recording"], row["case"]))


def score_job(job: Job, rows: Mapping[str, Mapping[str, Any]]) -> Row:
    """Score the row of one job, with those of other jobs that it needs for that: a copy with the scores.

    A row with an "error" is wrong.
    """
    row, question = rows[job.key], job.question
    head = {"recording": job.recording, "case": job.case}
    if job.variation != AS_ASKED:
        return _score_variation(job, head, row, rows.get(job.beside[0], {}))
    failed = "error" in row
    if isinstance(question, RecordedDrive):
        return {**head, "tier": "control", **(_failed_row(row) if failed else _score_whole(question, row))}
    if isinstance(question, DrivePair):
        scores = _failed_row(row) if failed else (_score_transfer if "errors" in row else _score_replication)(row)
        return {**head, "tier": job.case, **scores}
    if isinstance(question, EditedQuestion):
        return {**head, "tier": "edited", **(_failed_row(row) if failed else _score_edited(question, row))}
    assert isinstance(question, WithheldQuestion)  # noqa: S101  # there is no other
    whole = rows.get(job.beside[0], {"findings": []})
    return {**head, "tier": "withheld", **(_failed_row(row) if failed else _score_withheld(question, row, whole))}


def _failed_row(row: Mapping[str, Any]) -> Row:
    """The scores of a row with an "error"."""
    return {**row, "right": False, "false": []}


def may_have_answer(row: Mapping[str, Any]) -> bool:
    """Whether the row of a question lets it have an answer: what is missing is worth more than the diagnosis's gate.

    A row that does not tell its worth, such as one with an "error", says nothing against it.
    """
    return bool(row.get("worth", math.inf) > row.get("gate", 0.0))


def new_findings(row: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The findings that name what the simulation does not have."""
    return [f for f in row["findings"] if f["effect"] not in row.get("has", ())]


def given_names(row: Mapping[str, Any]) -> tuple[str, frozenset[str]]:
    """The answer in a diagnosis's row as far as it must not hang on a start: the verdict's kind, and the set of names.

    With any name the kind is "named", whether it stands alone or not.
    """
    names = frozenset(f["effect"] for f in row["findings"])
    return "named" if names else row["verdict"], names


def _score_whole(drive: RecordedDrive, row: Mapping[str, Any]) -> Row:
    """Score a diagnosis against a simulation of which nothing is withheld: right is no name beyond what that has.

    Where the tracking fails, right is no effect of the vehicle but those that other drives are known to show.
    """
    names = [f["effect"] for f in new_findings(row)]
    if drive.tracking_fails:
        names = [e for e in names if EFFECTS[e].kind == "vehicle" and e not in drive.known]
    return {**row, "right": not names, "false": names}


def _score_withheld(question: WithheldQuestion, row: Mapping[str, Any], whole: Mapping[str, Any]) -> Row:
    """Score the row of a question that withholds something from the simulation: has the diagnosis named it?

    It has an answer if what is withheld is worth more than the diagnosis's gate.  Right is then one of the withheld
    effects, or what the drive cannot tell from them ("equivalents"), among the findings and their twins, if these are
    fewer than `LIMITS.max_names_per_effect` plus the findings; or as a correction of the base model.  Otherwise the
    row is a control, and right is to name neither it nor anything false.

    Adds "first" (the first name is right), "false" (findings that are neither right nor shown with nothing withheld,
    in the row `whole`), "ratio" (of the errors in the effect's own channel) and "misfit" of the whole simulation.
    """
    effects, shows = question.withholding.effects, may_have_answer(row)
    accepted = {*effects, *question.withholding.parameters, *(row["equivalents"] if shows else ())}
    findings = new_findings(row) + [f for f in row["findings"] if f["effect"] in question.withholding.parameters]
    sets = [{f["effect"], *f["twins"]} for f in findings]
    few = len(set().union(*sets)) < LIMITS.max_names_per_effect + max(len(sets), 1)
    met = [few and any(set(name.split("+")) <= accepted for name in names) for names in sets]
    corrected = bool(set(row["corrections"]) & set(effects))
    excused = {name for f in whole["findings"] for name in (f["effect"], *f["twins"])}
    named, right = any(met) or corrected, [shows and is_met for is_met in met]
    false = [f["effect"] for f, ok in zip(findings, right, strict=True) if not ok and f["effect"] not in excused]
    return {
        **row, "tier": "withheld" if shows else "control", "effects": list(effects),
        "right": named if shows else not (named or false), "first": shows and (corrected or (bool(met) and met[0])),
        "false": false, "ratio": row["ratios"][own_quantity(effects)], "misfit": whole.get("misfit"),
    }  # fmt: skip


def _score_edited(question: EditedQuestion, row: Mapping[str, Any]) -> Row:
    """Score the row of a recording that was edited to show an effect of known size: is it found, at that size?

    Right is to name this effect alone, with its first parameter raised over its value "before" the edit by the edit's
    size, and its other parameters unchanged, within the tolerance of `_is_near`.  Where the edit is not named, and
    worth no more than the gate, the row is a control, and right is to name nothing else.  Adds "right", "value" (of the
    first parameter) and "false" (other names).
    """
    findings = new_findings(row)
    values = next((f["values"] for f in findings if f["effect"] == question.effect), None)
    others = [f["effect"] for f in findings if f["effect"] != question.effect]
    first, *unchanged = row["before"]
    true = {first: question.value, **dict.fromkeys(unchanged, 0.0)}
    size = abs(question.value)
    right = values is not None and all(_is_near(values[s], row["before"][s], true[s], size) for s in true)
    shows = values is not None or may_have_answer(row)
    return {
        **row, "tier": "edited" if shows else "control", "value": values[first][0] if values else None,
        "false": others, "right": (right or not shows) and not others,
    }  # fmt: skip


def _is_near(value: Sequence[float], before: Sequence[float], edit: float, size: float) -> bool:
    """Whether a parameter changed from `before` to `value`, both (value, standard error), by about `edit`.

    The tolerance of |value - before - edit| is the larger of `LIMITS.edit_error_share` times `size` and
    `LIMITS.edit_error_se` times the standard error of value - before, but at most `LIMITS.max_edit_error_share` times
    `size`.  `size` is the magnitude of the edit, also where this parameter should not change (`edit` is 0).
    """
    off, se = value[0] - before[0] - edit, math.hypot(value[1], before[1])
    near = max(LIMITS.edit_error_share * size, LIMITS.edit_error_se * se)
    return abs(off) < min(near, LIMITS.max_edit_error_share * size)


def _score_replication(row: Mapping[str, Any]) -> Row:
    """Score what two drives of one day show: right are the same names, each size the same or told as changed.

    Adds "empty": neither shows a name, and nothing is replicated.
    """
    names = not row["only"]["first"] and not row["only"]["second"]
    sizes = all(size["same"] or size["effect"] in row["changed"] for size in row["sizes"])
    more = {"same_names": names, "same_sizes": sizes, "empty": not any(row["named"])}
    return {**row, "right": names and sizes, "false": [], **more}


def _score_transfer(row: Mapping[str, Any]) -> Row:
    """Score predictions of another drive by their median errors: right is an augmented model below its base model.

    Adds "below_base" and "best": every other method has a larger median.  A lost prediction is endlessly wrong.
    """
    medians = {name: math.inf if e["median_m"] is None else e["median_m"] for name, e in row["errors"].items()}
    own = medians.pop(AUGMENTED)
    medians.pop(NAMED, None)  # a part of it
    return {
        **row, "right": own < medians[BASE], "false": [], "below_base": own < medians[BASE],
        "best": own < min(medians.values()),
    }  # fmt: skip


def _score_variation(job: Job, head: Row, row: Mapping[str, Any], asked: Mapping[str, Any]) -> Row:
    """Score a question asked once more: right is the answer, set of names and kind, that the question itself had."""
    failed = "error" in row or "error" in asked or not asked
    differs = failed or given_names(row) != given_names(asked)
    return {
        **head, "tier": "start" if job.variation.factors else "part", **row, "variation": job.variation.name,
        "differs": differs, "right": not differs, "false": [],
    }  # fmt: skip

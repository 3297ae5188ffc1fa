"""Answers of a suite, sealed before any case runs and opened afterwards, so that anybody can check them.

The seal of an answer is its HMAC-SHA-256 with the salt as the key.  Whoever knows the salt can open a seal; whoever
does not cannot guess an answer and compare.
"""

import hashlib
import hmac
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from bcid.documents.document import Document
from bcid.errors import InputRefused, UsageError
from bcid.files.outputs import replace_whole
from bcid.proof.blind.blind_case import BlindCase

SEALS_FILE, ANSWERS_FILE = "seals.json", "answers.json"
SEALED_DIGITS = 9
"""To so many digits the numbers of an answer are sealed: a logarithm ends otherwise on another processor.

A figure that is fitted may be rounded otherwise there all the same; a suite is then run anew in another folder.
"""
Count = Annotated[int, Field(ge=0)]


class SealsDocument(Document):
    """The whole of seals.json."""

    seal: str  # over all cases
    known_before: Count  # cases whose results existed before the answers were sealed
    cases: dict[str, str]  # the seal of each answer
    made_after_opening: Count = 0


def case_answer(case: BlindCase) -> dict[str, Any]:
    """All that is concealed in a blind case, as JSON: effects, parameters, and ids that the diagnosis may not name.

    Also the simulation's constants that make the effects, and whether its car has flaws that no effect describes; of a
    small car, the effects that are there beside the answer, and parameters that are others than published.
    """
    more = {"also": case.also, "other_parameters": case.other_parameters}
    beside = {name: values for name, values in more.items() if values}
    return {
        "case": case.name, "effects": {c.effect: dict(c.parameters) for c in case.concealed},
        "constants": {c.effect: {**c.plant, **c.sensor} for c in case.concealed}, "left_out": list(case.left_out),
        "channel": case.channel, "imperfect": case.imperfect, **beside,
    }  # fmt: skip


def sealed_answer(case: BlindCase) -> dict[str, Any]:
    """The answer of a blind case as it is sealed, and opened in the end: its numbers have SEALED_DIGITS digits."""
    return {name: _round(value) for name, value in case_answer(case).items()}


def _round(value: Any) -> Any:
    """The value, or all those in a mapping or a list, with SEALED_DIGITS digits where it is no whole number."""
    if isinstance(value, Mapping):
        return {name: _round(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_round(each) for each in value]
    return float(f"{value:.{SEALED_DIGITS}g}") if isinstance(value, float) else value


def answer_seal(case: BlindCase, salt: str) -> str:
    """Seal of a blind case's answer."""
    return seal_of(sealed_answer(case), salt)


def seal_of(answer: Mapping[str, Any], salt: str) -> str:
    """Seal of an answer in clear: the HMAC-SHA-256 (hex digits) of its JSON with `salt` as the key."""
    text = json.dumps(answer, sort_keys=True, ensure_ascii=True)
    return hmac.new(salt.encode(), text.encode(), hashlib.sha256).hexdigest()


def seal_over(seals: Iterable[str]) -> str:
    """One seal over those of all answers: the SHA-256 (hex digits) of these, joined in their order."""
    return hashlib.sha256("".join(seals).encode()).hexdigest()


def write_seals(cases: Sequence[BlindCase], salt: str, folder: Path, rows_before: int) -> str:
    """Write the seals (keyed hashes) of all cases' answers into `folder`; return one hash over all of them.

    If the folder already holds the same seals, they are kept.  `rows_before`, the number of cases whose results
    existed before the answers were sealed, is written with them.

    Raises:
        UsageError: the folder holds the seals of other answers or of another salt.
        InputRefused: the file of seals there is damaged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / SEALS_FILE
    seals = {c.name: answer_seal(c, salt) for c in cases}
    content = SealsDocument(seal=seal_over(seals.values()), known_before=rows_before, cases=seals)
    if path.exists():
        before = SealsDocument.read(path)
        if (before.cases, before.seal) != (seals, content.seal):
            cause = "holds the seals of other answers, or those of another version or processor"
            raise UsageError(f"--out {folder}: {cause}\n  next: name another folder")
    else:
        _replace_json(path, content.as_json())
    return content.seal


def open_seals(cases: Sequence[BlindCase], salt: str, folder: Path, new_rows: int = 0) -> dict[str, Any]:
    """Check that the answers of the `cases` fit their seals (keyed hashes) in `folder`, then write them there in clear.

    Returns the counts "opened" (these cases), "known_before" (cases with results before the answers were sealed) and
    "made_after_opening" (results made when answers and salt were already readable in the folder, so not blind).
    `new_rows` is the number of results of this run.

    Raises:
        InputRefused: a seal does not fit its answer.
    """
    path = folder / SEALS_FILE
    content = SealsDocument.read(path)
    for case in cases:
        if not hmac.compare_digest(content.cases.get(case.name, "").encode(), answer_seal(case, salt).encode()):
            raise InputRefused(path, case.name, "the seal does not fit the answer", "run anew in another folder")
    if (folder / ANSWERS_FILE).is_file():
        content = content.model_copy(update={"made_after_opening": content.made_after_opening + new_rows})
        _replace_json(path, content.as_json())
    answers = {"salt": salt, "answers": [sealed_answer(case) for case in cases]}
    _replace_json(folder / ANSWERS_FILE, answers)
    after = content.made_after_opening
    return {"opened": len(cases), "known_before": content.known_before, "made_after_opening": after}


def _replace_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write `content` as a JSON file that replaces the one at `path` in one step, when it is whole."""
    replace_whole(path, lambda unfinished: unfinished.write_text(json.dumps(content, indent=1), encoding="utf-8"))

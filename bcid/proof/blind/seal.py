"""The answers of a suite, sealed before a diagnosis runs and opened after: anybody can check that none was changed.

The seal of a case is the SHA-256 of salt and answer.  Who knows the salt can open it; who does not cannot guess an
answer and compare.
"""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bcid.errors import InputRefused, UsageError
from bcid.proof.blind.cases import Case

SEALS, ANSWERS = "seals.json", "answers.json"


def answer_of(case: Case) -> dict[str, Any]:
    """All that is concealed in a case, and what its answer is held against; its name tells the tier."""
    return {
        "case": case.name, "effects": {c.effect: dict(c.parameters) for c in case.concealed},
        "constants": {c.effect: {**c.plant, **c.sensor} for c in case.concealed}, "left_out": list(case.left_out),
        "channel": case.channel, "imperfect": case.imperfect,
    }  # fmt: skip


def sealed(case: Case, salt: str) -> str:
    """The seal of one case's answer."""
    text = json.dumps(answer_of(case), sort_keys=True, ensure_ascii=True)
    return hmac.new(salt.encode(), text.encode(), hashlib.sha256).hexdigest()


def seal_of(cases: Sequence[Case], salt: str) -> str:
    """One seal over all cases, in their order."""
    return hashlib.sha256("".join(sealed(case, salt) for case in cases).encode()).hexdigest()


def seal_up(cases: Sequence[Case], salt: str, folder: Path, known: int) -> str:
    """Write the seals of all cases into `folder` before any runs; returns the one over all.

    `known` is how many of their rows lie there already, and were therefore made before.

    Raises:
        UsageError: the folder holds the seals of other answers, or of another salt.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / SEALS
    content = {"seal": seal_of(cases, salt), "known_before": known, "cases": {c.name: sealed(c, salt) for c in cases}}
    if path.is_file():
        before = json.loads(path.read_text(encoding="utf-8"))
        if before["cases"] != content["cases"]:
            raise UsageError(f"--out {folder}: holds the seals of other answers\n  next: name another folder")
        return str(before["seal"])
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
    return str(content["seal"])


def opened(cases: Sequence[Case], salt: str, folder: Path, made: int = 0) -> dict[str, Any]:
    """Write the answers of the cases that have run beside their seals, and hold each against its seal.

    Who knows the salt can open all others, too: of a run that went on after a part was opened, so many rows as were
    `made` since were not made blindly.  Returns how many seals fit, how many rows were known before the seal, and how
    many were made after an opening.

    Raises:
        InputRefused: a seal that does not fit.
    """
    path = folder / SEALS
    content = json.loads(path.read_text(encoding="utf-8"))
    for case in cases:
        if not hmac.compare_digest(content["cases"].get(case.name, ""), sealed(case, salt)):
            raise InputRefused(path, case.name, "the seal does not fit the answer", "run anew in another folder")
    if (folder / ANSWERS).is_file():
        content["made_after_opening"] = content.get("made_after_opening", 0) + made
        path.write_text(json.dumps(content, indent=1), encoding="utf-8")
    answers = {"salt": salt, "answers": [answer_of(case) for case in cases]}
    (folder / ANSWERS).write_text(json.dumps(answers, indent=1), encoding="utf-8")
    told = {k: content.get(k, 0) for k in ("known_before", "made_after_opening")}
    return {"opened": len(cases), **told}

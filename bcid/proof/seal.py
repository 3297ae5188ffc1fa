"""The answers of a suite, sealed before a diagnosis runs and opened after: anybody can check that none was changed.

The seal of a case is the SHA-256 of salt and answer.  Who knows the salt can open it; who does not cannot guess an
answer and compare.
"""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Sequence
from typing import Any

from bcid.proof.cases import Case


def answer_of(case: Case) -> dict[str, Any]:
    """All that is concealed in a case."""
    return {
        "case": case.name, "effects": {c.effect: dict(c.parameters) for c in case.concealed},
        "constants": {c.effect: {**c.plant, **c.sensor} for c in case.concealed}, "left_out": list(case.left_out),
        "imperfect": case.imperfect,
    }  # fmt: skip


def sealed(case: Case, salt: str) -> str:
    """The seal of one case's answer."""
    text = json.dumps(answer_of(case), sort_keys=True, ensure_ascii=True)
    return hmac.new(salt.encode(), text.encode(), hashlib.sha256).hexdigest()


def seal_of(cases: Sequence[Case], salt: str) -> str:
    """One seal over all cases, in their order."""
    return hashlib.sha256("".join(sealed(case, salt) for case in cases).encode()).hexdigest()

"""All of a diagnosis that is scored."""

from __future__ import annotations

from typing import Any

from bcid.diagnosis.candidates import corrections
from bcid.diagnosis.diagnose import Diagnosis
from bcid.effects.table import EFFECTS


def said(found: Diagnosis) -> dict[str, Any]:
    """Verdict, findings, and what is located, left and not excited, as JSON holds it."""
    judgement, location = found.judgement, found.location
    left, place, window = judgement.left.remainder, location.place, location.window
    return {
        "verdict": judgement.verdict,
        "findings": [
            {
                "effect": f.effect, "kind": EFFECTS[f.effect].kind, "twins": list(f.twins),
                "probability": round(f.probability, 4), "gain": round(f.gain, 1), "heldout": round(f.heldout.nats, 1),
                "values": {k: list(v) for k, v in f.values.items()},
            }
            for f in judgement.findings
        ],
        "dropped": list(judgement.dropped),
        "corrections": list(corrections(judgement.fit)),
        "remainder": {
            "channel": judgement.left.channel, "entering": judgement.left.entering, "correlations": left.correlations,
            "gain": round(left.gain, 1), "nats": round(judgement.nats_left, 1),
            "lying": {way.channel: round(way.nats, 1) for way in judgement.left.lying},
        },
        "located": location.channel,
        "place": [place.x, place.y, place.radius] if place else None,
        "window": [window.begin_s, window.end_s] if window else None,
        "p_value": found.p_value,
        "not_excited": {u.effect: u.smallest for u in found.unexcited},
    }  # fmt: skip

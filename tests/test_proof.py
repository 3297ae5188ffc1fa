"""The blind test's own honesty: cases, the wall between answer and diagnosis, and the counting."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest

from bcid.diagnosis import diagnose
from bcid.effects.table import EFFECTS
from bcid.proof.cases import suite
from bcid.proof.concealed import MEASUREMENT, SIZES
from bcid.proof.running import recorded, vehicle
from bcid.proof.scoring import tiers


def test_every_effect_of_the_vocabulary_can_be_concealed() -> None:
    assert set(SIZES) == set(EFFECTS)
    assert set(MEASUREMENT) == {n for n, e in EFFECTS.items() if e.kind == "measurement"}
    for name, effect in EFFECTS.items():
        main = effect.parameters[0]
        assert SIZES[name].low <= main.size <= SIZES[name].high, name


def test_a_suite_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    one, same, other = (list(suite(seed, 1, 2, 2, 2)) for seed in (1, 1, 2))
    assert one == same
    assert one != other
    assert len({c.name for c in one}) == len(one)
    for case in one:
        for concealed in case.concealed:
            assert set(concealed.parameters) == {p.symbol for p in EFFECTS[concealed.effect].parameters}


def test_the_diagnosis_is_handed_no_answer() -> None:
    case = next(c for c in suite(1, 1, 0, 0, 0) if c.answer == ("yaw_scrub",))
    recording = recorded(case, vehicle())
    assert recording.name == "concealed"
    assert "yaw_scrub" not in repr(recording)
    assert "proof" not in Path(inspect.getfile(diagnose)).read_text()


def row(case: str, answer: list[str], found: list[str], **more: Any) -> dict[str, Any]:
    findings = [
        {"effect": e, "kind": EFFECTS[e].kind, "twins": [], "probability": 1.0, "gain": 100.0, "heldout": 90.0,
         "values": {EFFECTS[e].parameters[0].symbol: [1.02, 0.02]}}
        for e in found
    ]  # fmt: skip
    truth = {e: {EFFECTS[e].parameters[0].symbol: 1.0} for e in answer}
    verdict = "named" if found else "nothing-found"
    base = {"case": case, "tier": "single", "answer": answer, "channel": "", "verdict": verdict, "findings": findings}
    return {**base, "remainder": {"channel": "fx"}, "truth": truth, "seconds": 1.0, **more}


def test_counting() -> None:
    rows = [
        row("single-0001", ["yaw_scrub"], ["yaw_scrub"]),
        row("single-0002", ["yaw_scrub"], ["rear_toe"]),
        row("single-0003", ["pose_scale"], ["pose_scale", "rear_toe"]),
        row("null-0004", [], [], tier="null"),
        row("null-0005", [], ["rear_toe"], tier="null"),
        row("left-out-0006", ["yaw_scrub"], [], tier="left-out", channel="mz", verdict="unknown",
            remainder={"channel": "mz"}),
    ]  # fmt: skip
    single, null, hidden = tiers(rows)
    assert single.top1 == pytest.approx(2 / 3)
    assert single.exact == pytest.approx(1 / 3)
    assert single.wrong == pytest.approx(2 / 3)
    assert single.parameter_error == pytest.approx(0.02)
    assert single.coverage == 1.0
    assert single.kind == 1.0
    assert null.false == 0.5
    assert null.false_ci95 is not None
    assert null.false_ci95[0] < 0.5 < null.false_ci95[1]
    assert hidden.channel == 1.0
    assert hidden.wrong == 0.0

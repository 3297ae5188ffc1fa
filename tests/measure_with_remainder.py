"""What a diagnosis's models predict on blocks of a real drive that they were not fitted to.

`python tests/measure_with_remainder.py RECORDINGS` diagnoses each drive of the real questions freely and predicts it by
the base model, with the names, and with what has no name, each cross-validated over halves of the drive's blocks.  It
writes docs/results/real_held_out.json after each drive, goes on where it was stopped, and the table of
docs/real_recordings.md tells it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.diagnosis.judge.prediction_error import compare_predictions
from bcid.errors import InputRefused
from bcid.proof.real.jobs import QuestionInputs, question_code_digest, read_questions

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results" / "real_held_out.json"
FILES = ("pipelines/dart/cases.toml", "pipelines/f1tenth/cases.toml")
STAGES = ("before", "after", "remainder", "floor")


def measure_drive(name: str, inputs: QuestionInputs) -> dict[str, Any]:
    """Errors (NMSE) by horizon of one drive, and what the diagnosis of it says."""
    vehicle = inputs.vehicle_for(name)
    recording, estimate, tuning = inputs.estimate_recording(name, vehicle)
    found = diagnose_recordings([recording], [estimate], vehicle)
    unknown = found.naming.unknown_nats > 0.0
    rows, _, share = compare_predictions(
        found.naming.base, found.fit, found.take, recording, estimate, vehicle, tuning, with_remainder=unknown
    )  # fmt: skip
    return {
        "verdict": found.judgement.verdict,
        "names": [f.effect for f in found.judgement.findings],
        "function_share": share,
        "errors": {f"{row.horizon_s:g}": {s: getattr(row, f"nmse_{s}") for s in STAGES} for row in rows},
    }


def main(recordings: Path) -> None:
    """Measure what is not measured yet with this code."""
    code = question_code_digest()
    told = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    told = told if told.get("code") == code else {"code": code, "drives": {}}
    for file in FILES:
        questions = read_questions(ROOT / file)
        inputs = QuestionInputs.of_questions(questions, recordings)
        for name in inputs.drives.keys() - told["drives"].keys():
            try:
                told["drives"][name] = measure_drive(name, inputs)
            except InputRefused as refusal:
                told["drives"][name] = {"refused": str(refusal)}
            RESULTS.write_text(json.dumps(told, indent=1, sort_keys=True) + "\n", encoding="utf-8")
            sys.stdout.write(f"{name}: {told['drives'][name]}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))

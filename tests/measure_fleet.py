"""How often the logs of a fleet together show which effect it has, since which day and in how many logs.

    python tests/measure_fleet.py ROWS.jsonl [FLEETS] [WORKERS]

diagnoses twelve logs of 90 s of each fleet, four on each of three days, and writes docs/results/fleet.json when all are
there; the same command goes on where it was stopped.  A fleet is a small car drawn anew, with its published simulation.
In the first FLEETS an effect of the vocabulary is in four of the eight logs from the second day on, in as many further
ones there is none.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.diagnosis.summary import summarise_diagnosis
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.execution.jobs import run_jobs
from bcid.fleet.log_evidence import LogEvidence
from bcid.fleet.occurrences import find_occurrences
from bcid.proof.blind.diagnose_case import estimate_concealed_drive
from bcid.proof.blind.small_case import SmallCase
from bcid.proof.blind.small_effects import SMALL_SIZES, draw_small_effect, kinds_of_car
from bcid.proof.blind.small_files import PUBLISHED
from bcid.simulation.small_car import draw_small_car
from bcid.virtual_lab import read_vehicle_text, record_drive

RESULT = Path(__file__).parents[1] / "docs" / "results" / "fleet.json"
LOGS, DAYS, AFFECTED, SECONDS, TRUST = 12, 3, 4, 90.0, 0.05
DAY_OF = [log * DAYS // LOGS for log in range(LOGS)]
# a load is in a whole log or in none, and then it is the mass; a time within the log is no other day
NOT_DRAWN = ("mass_change",)


def draw_fleet(number: int, fleets: int) -> list[SmallCase]:
    """The logs of a fleet; those numbered below `fleets` have an effect in some."""
    rng = np.random.default_rng([4401, number])
    names = [name for name in SMALL_SIZES if name not in NOT_DRAWN]
    effect = str(rng.choice(names))
    own = tuple(constant for constant, (published, _) in PUBLISHED.items() if published == effect)
    car = draw_small_car(rng, lacking=own)
    while effect not in kinds_of_car(car.plant):
        car = draw_small_car(rng, lacking=own)
    later = [log for log in range(LOGS) if DAY_OF[log] > 0]
    affected = set(rng.choice(later, AFFECTED, replace=False).tolist()) if number < fleets else set()
    while number < fleets and not any(DAY_OF[log] == 1 for log in affected):
        affected = set(rng.choice(later, AFFECTED, replace=False).tolist())
    hidden = draw_small_effect(effect, car.plant, rng, SECONDS)
    usual = SmallCase(
        "fleet", 0, (), seed=number, car=car, trust=TRUST, duration_s=SECONDS, rate_hz=100.0, command_hz=20.0
    )
    return [
        replace(usual, number=log, concealed=(hidden,) if log in affected else (), driver=_driver(log))
        for log in range(LOGS)
    ]


def _driver(log: int) -> str:
    """Who drives a log: each in turn."""
    from bcid.simulation.room_drivers import DRIVERS

    return list(DRIVERS)[log % len(DRIVERS)]


def diagnose_log(case: SmallCase) -> dict[str, Any]:
    """The diagnosis of one log as its document, and what was concealed."""
    files = case.lab_files
    vehicle = read_vehicle_text(files.vehicle)
    recording = record_drive(case.simulate(), case.rate_hz, vehicle, case.name)
    estimate, reference = estimate_concealed_drive(recording, vehicle, files.vehicle, files.simulation)
    diagnosis = diagnose_recordings([recording], [estimate], vehicle, reference=reference)
    return {"answer": list(case.answer), "diagnosis": summarise_diagnosis(diagnosis).as_json()}


def judge_fleet(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the logs of a fleet together say, beside the truth."""
    logs = [LogEvidence.of_diagnosis(DiagnosisDocument.model_validate(row["diagnosis"])) for row in rows]
    found = find_occurrences(logs, DAY_OF, [""] * LOGS)
    truth = [effect for row in rows for effect in row["answer"]][:1]
    first = found[0] if found else None
    right = first is not None and [first.effect] == truth
    return {
        "truth": truth, "affected": [bool(row["answer"]) for row in rows],
        "named": [[f["effect"] for f in row["diagnosis"]["findings"]] for row in rows],
        "found": [[f.effect, round(f.nats, 1), f.day, round(f.share, 2), list(f.twins)] for f in found],
        "in_logs": [round(float(p), 2) for p in first.in_logs] if first else [],
        "effect": right, "or_twin": first is not None and truth[:1] and truth[0] in (first.effect, *first.twins),
        "day": first is not None and first.day == 1,
        "share": first is not None and abs(float(first.in_logs.sum()) - AFFECTED) <= 1.0,
        "further": len(found) - 1 if right else len(found),
    }  # fmt: skip


def main() -> None:
    """Diagnose what has no row yet, and judge the fleets that are complete."""
    path, fleets = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 20
    workers = int(sys.argv[3]) if len(sys.argv) > 3 else 1
    rows: dict[str, dict[str, Any]] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        entry = json.loads(line)
        rows[entry["key"]] = entry["row"]
    jobs = [(number, log) for number in range(2 * fleets) for log in range(LOGS) if f"{number}-{log}" not in rows]

    def prepare(job: tuple[int, int]) -> Callable[[], dict[str, Any]]:
        """The diagnosis of one log."""
        return partial(diagnose_log, draw_fleet(job[0], fleets)[job[1]])

    for (number, log), row in run_jobs(jobs, prepare, workers) if jobs else ():
        rows[f"{number}-{log}"] = row
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": f"{number}-{log}", "row": row}) + "\n")
    judged = [judge_fleet([rows[f"{number}-{log}"] for log in range(LOGS)]) for number in range(2 * fleets)]
    with_one, without = judged[:fleets], judged[fleets:]
    figures = {
        "fleets": fleets, "right": sum(f["effect"] and f["day"] and f["share"] for f in with_one),
        "effect": sum(f["effect"] for f in with_one), "effect_or_twin": sum(bool(f["or_twin"]) for f in with_one),
        "day": sum(f["day"] for f in with_one), "share": sum(f["share"] for f in with_one),
        "further": sum(f["further"] for f in with_one), "without_any": sum(not f["found"] for f in without),
        "each": judged,
    }  # fmt: skip
    RESULT.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(f"{ {k: v for k, v in figures.items() if k != 'each'} }\n")


if __name__ == "__main__":
    main()

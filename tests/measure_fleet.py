"""How often the logs of a fleet together show which effect it has, since which day and in how many logs.

    python tests/measure_fleet.py FOLDER [FLEETS] [WORKERS]

diagnoses twelve logs of a minute of each fleet, four on each of three days, keeps them in FOLDER/rows.jsonl, and
writes docs/results/fleet.json when all are there; the same command goes on where it was stopped.  A fleet is a small
car drawn anew, with its published simulation.  In the first FLEETS an effect of the vocabulary is in four of the eight
logs from the second day on, in as many further ones there is none.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from concealed import record_case

from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.diagnosis.summary import summarise_diagnosis
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.execution.jobs import run_jobs
from bcid.fleet.labels import LogLabel
from bcid.fleet.together import DiagnosedLog, diagnose_together
from bcid.proof.blind.run_cases import ROW_MODULES
from bcid.proof.blind.small_case import SmallCase
from bcid.proof.blind.small_effects import SMALL_SIZES, draw_small_effect, kinds_of_car
from bcid.proof.blind.small_files import PUBLISHED
from bcid.proof.rows import append_row, code_digest, read_rows
from bcid.simulation.room_drivers import DRIVERS
from bcid.simulation.small_car import draw_small_car

RESULT = Path(__file__).parents[1] / "docs" / "results" / "fleet.json"
LOGS, DAYS, AFFECTED, SECONDS, TRUST = 12, 3, 4, 60.0, 0.05
SINCE = 0.5  # share of the logs since the second day that have it
WITHOUT = 1000  # number of the first fleet without an effect
DAY_OF = [log * DAYS // LOGS for log in range(LOGS)]
# a load is in a whole log or in none, and then it is the mass; a time within the log is no other day
NOT_DRAWN = ("mass_change",)


def draw_fleet(number: int) -> list[SmallCase]:
    """The logs of a fleet; those numbered below WITHOUT have an effect in some."""
    rng = np.random.default_rng([4401, number])
    effect = str(rng.choice([name for name in SMALL_SIZES if name not in NOT_DRAWN]))
    own = tuple(constant for constant, (published, _) in PUBLISHED.items() if published == effect)
    car = draw_small_car(rng, lacking=own)
    while effect not in kinds_of_car(car.plant):
        car = draw_small_car(rng, lacking=own)
    hidden = draw_small_effect(effect, car.plant, rng, SECONDS)
    affected = _draw_affected(rng) if number < WITHOUT else []
    usual = SmallCase(
        "fleet", 0, (), seed=number, car=car, trust=TRUST, duration_s=SECONDS, rate_hz=100.0, command_hz=20.0
    )
    return [
        replace(usual, number=log, concealed=(hidden,) if log in affected else (), driver=DRIVERS[log % len(DRIVERS)])
        for log in range(LOGS)
    ]


def _draw_affected(rng: np.random.Generator) -> list[int]:
    """The logs that have the effect: from the second day on, of which at least one has it."""
    later = [log for log in range(LOGS) if DAY_OF[log] > 0]
    while True:
        affected: list[int] = rng.choice(later, AFFECTED, replace=False).tolist()
        if any(DAY_OF[log] == 1 for log in affected):
            return affected


def diagnose_log(case: SmallCase) -> dict[str, Any]:
    """The diagnosis of one log as its document, and what was concealed."""
    drive = record_case(case, case.name)
    diagnosis = diagnose_recordings([drive.recording], [drive.estimate], drive.vehicle, reference=drive.reference)
    return {"answer": list(case.answer), "diagnosis": summarise_diagnosis(diagnosis).as_json()}


def judge_fleet(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the logs of a fleet together say, beside the truth."""
    days = [f"2026-11-{28 + day}" for day in DAY_OF]
    logs = [
        DiagnosedLog(f"log_{i}", LogLabel(day), DiagnosisDocument.model_validate(row["diagnosis"]))
        for i, (day, row) in enumerate(zip(days, rows, strict=True))
    ]
    together = diagnose_together(logs, sorted(set(days)))
    assert together is not None
    truth, affected = {effect for row in rows for effect in row["answer"]}, [bool(row["answer"]) for row in rows]
    first = together.effects[0] if together.effects else None
    right = first is not None and {first.effect} == truth
    count = sum(first.in_logs.values()) if first else 0.0
    return {
        "truth": sorted(truth), "affected": affected,
        "named": [[f["effect"] for f in row["diagnosis"]["findings"]] for row in rows],
        "effects": [e.model_dump(mode="json") for e in together.effects],
        "effect": right, "effect_or_twin": first is not None and bool(truth & {first.effect, *first.twins}),
        "day": first is not None and first.since == days[LOGS // DAYS],
        "share": bool(first and first.share_ci90[0] <= SINCE <= first.share_ci90[1] and abs(count - AFFECTED) <= 1),
        "further": max(len(together.effects) - 1, 0) if truth else len(together.effects),
        "moved": [[m.symbol, m.day, round(m.change, 4), round(m.p_value, 5)] for m in together.moved],
    }  # fmt: skip


def main() -> None:
    """Diagnose what has no row yet, and judge the fleets."""
    folder, fleets = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 20
    workers = int(sys.argv[3]) if len(sys.argv) > 3 else 1
    folder.mkdir(parents=True, exist_ok=True)
    numbers = [*range(fleets), *range(WITHOUT, WITHOUT + fleets)]
    code = code_digest([*ROW_MODULES, "bcid.diagnosis.summary"])
    cases = {(number, log): case for number in numbers for log, case in enumerate(draw_fleet(number))}
    keys, rows = {job: f"{case.digest()}.{code}" for job, case in cases.items()}, read_rows(folder)
    jobs = [job for job, key in keys.items() if key not in rows]
    for job, row in run_jobs(jobs, lambda job: partial(diagnose_log, cases[job]), workers):
        append_row(row, keys[job], folder)
        rows[keys[job]] = row
    judged = [judge_fleet([rows[keys[number, log]] for log in range(LOGS)]) for number in numbers]
    with_one, without = judged[:fleets], judged[fleets:]
    figures = {
        "fleets": fleets, "code": code,
        "right": sum(f["effect"] and f["day"] and f["share"] and not f["further"] for f in with_one),
        **{name: sum(f[name] for f in with_one) for name in ("effect", "effect_or_twin", "day", "share", "further")},
        "without_any": sum(not f["effects"] for f in without), "without_moved": sum(not f["moved"] for f in without),
    }  # fmt: skip
    RESULT.write_text(json.dumps({"figures": figures, "fleets": judged}, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(figures, indent=1))  # noqa: T201


if __name__ == "__main__":
    main()

"""How often the checks are right on fresh drives: `python tests/measure_checks.py [SEED] [N]`.

The figures go to docs/results/checks.json.

Clean drives of five vehicles must be go without a warning, spoiled ones no-go with the cause first, clock offsets and
servos inside their 95 % intervals, exact clocks never called off.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from fleet import DRIVERS, KINDS, Drive, draw_drive, shifted
from spoiled import SPOILED, name_first_cause

from bcid.errors import InputRefused
from bcid.estimate.steering import identify_steering
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.health import assess_health

RESULTS = Path(__file__).parents[1] / "docs" / "results" / "checks.json"
TOLD = (
    "steering",
    "throttle",
    "poses",
    "other commands",
    "clock offset",
    "clock drift",
    "clock jump",
    "vehicle file",
    "yaw offset",
    "scale",
)
"""Kinds of irregularities that a clean drive has not."""
LIVELY = ("targets", "wanders", "laps")  # drivers who show what a throttle does


def is_clean(drive: Drive, minimal: bool) -> str | None:
    """What is wrongly said of a clean drive; None where it is a go."""
    vehicle = drive.kind.vehicle(minimal)
    try:
        recording = assemble_recording(drive.raw, vehicle)
    except InputRefused as refusal:
        return f"{drive.label}: refused: {refusal}"
    odd = [f"{i.kind}: {i.detail}" for i in recording.irregularities if i.kind in TOLD]
    health = assess_health(recording, vehicle)
    return None if health.go and not odd else f"{drive.label}: {odd or health.sentence}"


def measure_clean(seeds: range) -> dict[str, Any]:
    """Clean drives, half of them with a vehicle file of four lines."""
    wrong = [said for seed in seeds if (said := is_clean(draw_drive(seed), seed % 2 == 1)) is not None]
    return {"drives": len(seeds), "go_without_a_warning": len(seeds) - len(wrong), "wrong": wrong}


def measure_spoiled(seeds: range) -> dict[str, Any]:
    """Each way of spoiling a drive, tried on several vehicles: how often the right cause comes first."""
    found = {}
    for name, way in SPOILED.items():
        right = 0
        for seed in seeds:
            kinds = way.kinds or tuple(KINDS)
            drive = draw_drive(seed, kinds[seed % len(kinds)], LIVELY[seed % 3])
            said = name_first_cause(
                way.make(drive, np.random.default_rng(seed)), drive, seed % 3 == 0, **way.vehicle(drive)
            )
            right += bool(said and re.search(way.cause, said))
        found[name] = {"takes": len(seeds), "right_cause": right}
    return found


def measure_clocks(seeds: range) -> dict[str, Any]:
    """Clock offsets of up to 5 s: how often the 95 % interval holds; and exact clocks with a file of four lines."""
    rng, told, inside, called_off, wrong = np.random.default_rng(seeds.start), 0, 0, 0, list[str]()
    for seed in seeds:
        drive, late_s = draw_drive(seed), float(rng.uniform(-5.0, 5.0))
        try:
            clock = assemble_recording(shifted(drive.raw, late_s), drive.kind.vehicle(seed % 2 == 1)).clock
        except InputRefused as refusal:
            wrong.append(f"{drive.label}: refused: {refusal}")
            continue
        if clock.offset_ci95 is not None:
            told += 1
            if clock.offset_ci95[0] <= -late_s <= clock.offset_ci95[1]:
                inside += 1
            else:
                wrong.append(f"{drive.label}: {-late_s:.4f} s is not in {clock.offset_ci95}")
        exact = assemble_recording(drive.raw, drive.kind.vehicle(True))
        called_off += any(i.kind.startswith("clock") for i in exact.irregularities)
    return {"takes": len(seeds), "told": told, "inside_95": inside, "exact_called_off": called_off, "wrong": wrong}


def measure_servo(seeds: range) -> dict[str, Any]:
    """The servo of a 1:10 car in takes of a minute: how often T_s and d lie within their 95 % intervals."""
    plant, inside, rates, rates_inside = KINDS["rc"].plant, 0, 0, 0
    for seed in seeds:
        drive = draw_drive(seed, "rc", list(DRIVERS)[seed % len(DRIVERS)], 60.0)
        vehicle = drive.kind.vehicle(True)
        _, _, origin = identify_steering([assemble_recording(drive.raw, vehicle)], vehicle)
        inside += origin.T_s_ci95 is not None and origin.T_s_ci95[0] <= plant.servo_time <= origin.T_s_ci95[1]
        if origin.d_ci95 is not None:
            rates += 1
            rates_inside += origin.d_ci95[0] <= plant.servo_rate <= origin.d_ci95[1]
    return {"takes": len(seeds), "T_s_inside_95": inside, "d_identified": rates, "d_inside_95": rates_inside}


def measurements(seed: int, count: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each measurement by its name, of `count` drives from `seed` on."""
    yield "clean", measure_clean(range(seed, seed + count))
    yield "spoiled", measure_spoiled(range(seed, seed + max(count // 10, 1)))
    yield "clocks", measure_clocks(range(seed, seed + count))
    yield "servo", measure_servo(range(seed, seed + count))


if __name__ == "__main__":
    first = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    figures: dict[str, Any] = {"schema": "bcid.checks/1", "seed": first}
    for title, result in measurements(first, int(sys.argv[2]) if len(sys.argv) > 2 else 100):
        figures[title] = result
        sys.stdout.write(f"{title} {json.dumps(result, indent=1, ensure_ascii=False)}\n")
    RESULTS.write_text(json.dumps(figures, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

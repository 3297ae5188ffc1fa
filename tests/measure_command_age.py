"""How surely the age of logged commands is found, and what it is worth on real drives.

`python tests/measure_command_age.py RECORDINGS` drives the fleet with and without a recorder that reads the commands at
its own rate, fits the published structure to the DART drives with and without [clock] of their vehicle file, and writes
docs/results/command_age.json.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from fleet import Drive, draw_drive
from test_command_age import read_anew, said_of_age

from bcid.errors import InputRefused
from bcid.recording.assemble import assemble_recording
from bcid.recording.formats.raw import RawTake

ROOT = Path(__file__).parents[1]
DART = ROOT / "pipelines" / "dart"
DRIVES = (
    "dart/82_huge_datest_for_gp_fitting/car_1_Datarecording_09_16_2024_10_01_01.csv",
    "dart/82_huge_datest_for_gp_fitting/car_1_Datarecording_09_16_2024_10_02_28.csv",
)
STATED: tuple[tuple[str, ...], ...] = ((), ("offset_s",), ("commands_read_every_s", "offset_s"))
"""Which entries of the vehicle file's [clock] are used."""
CLEAN, READ = range(70_000, 70_100), range(71_000, 71_060)
LEAST_PERIOD_S = 0.04


def main() -> None:
    """Measure and write."""
    found = {"clean drives": _count(_clean()), "read at another rate": _count(_read_at_another_rate())}
    real = [_fit(Path(sys.argv[1]), drive, stated) for drive in DRIVES for stated in STATED]
    text = json.dumps({"fleet": found, "dart": real}, indent=1)
    (ROOT / "docs" / "results" / "command_age.json").write_text(text + "\n", encoding="utf-8")


def _clean() -> Iterator[tuple[Drive, RawTake]]:
    """Drives whose commands are stamped when they are sent."""
    for seed in CLEAN:
        drive = draw_drive(seed)
        yield drive, drive.raw


def _read_at_another_rate() -> Iterator[tuple[Drive, RawTake]]:
    """Drives whose commands a recorder reads at a rate that is 0.1 to 0.4 % off theirs."""
    for seed in READ:
        drive, rng = draw_drive(seed), np.random.default_rng([seed, 5])
        period = float(np.median(np.diff(drive.raw.command_time_s)))
        if period >= LEAST_PERIOD_S:
            off = rng.choice((-1.0, 1.0)) * rng.uniform(0.001, 0.004)
            yield drive, read_anew(drive.raw, period * (1.0 + off), period * rng.random())


def _count(takes: Iterator[tuple[Drive, RawTake]]) -> dict[str, int]:
    """How many takes there are, how many are read, and of how many an age is told."""
    drives = read = told = 0
    for drive, raw in takes:
        drives += 1
        try:
            recording = assemble_recording(raw, drive.kind.vehicle())
        except InputRefused:
            continue
        read += 1
        told += bool(said_of_age(recording))
    return {"drives": drives, "read": read, "told": told}


def _fit(recordings: Path, drive: str, stated: tuple[str, ...]) -> dict[str, Any]:
    """The published structure fitted to a drive, with what of the commands' clock in the vehicle file is `stated`."""
    from bcid.diagnosis.diagnose import fit_base_model
    from bcid.proof.real.question_files import QuestionInputs
    from bcid.proof.real.questions import read_questions
    from bcid.vehicle import Clock

    questions = read_questions(DART / "cases.toml")
    inputs = QuestionInputs.of_questions(questions, recordings)
    vehicle = inputs.vehicle_for(drive)
    clock = Clock(**{name: getattr(vehicle.clock, name) for name in stated})
    vehicle = vehicle.model_copy(update={"clock": clock})
    recording, estimate, _ = inputs.estimate_recording(drive, vehicle)
    published = inputs.published_model([estimate], vehicle)
    assert published is not None
    fit = fit_base_model([recording], [estimate], vehicle, published).fit
    car = fit.car()
    told = [odd.detail for odd in said_of_age(recording)]
    symbols = ("I_z", "C_f", "C_r", "F_f_max", "F_r_max", "K_t")
    return {
        "recording": drive, "stated": stated, "told": told, "nats": fit.penalised_log_likelihood,
        **{symbol: {"fitted": getattr(car, symbol), "published": getattr(published.car, symbol)} for symbol in symbols},
    }  # fmt: skip


if __name__ == "__main__":
    main()

"""Whether results depend on when a take begins: fixed drives, their first pose at several phases of the commands.

`python tests/command_phase.py FILE` fits all models to four drives of the simulated car, whose commands come ten times
a second, and scores them on a fifth, for each phase and seed; FILE is docs/results/command_phase.json.
"""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import nmse, predict_whole_take
from bcid.models.fitting.windows import inverse_spread
from bcid.models.interface import FitTask, Model
from bcid.models.table import MODELS
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import Drive, simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

PHASES_S, SEEDS = (0.0, 0.01, 0.05, 0.09), (1, 2, 3)
RATE_HZ = 100.0
PIPELINE = Path(__file__).parents[1] / "pipelines" / "bumper_car.toml"


def drive_at_10_hz(seconds: float, seed: int) -> Drive:
    """A drive of the simulated car under a driver's commands, each held for 0.1 s, with 100 poses a second."""
    driver = simulate_drive(Plant(), Sensor(rate_hz=RATE_HZ), seconds, seed)
    held = np.repeat(driver.command[::2], 2, axis=0)[: len(driver.command)]
    return simulate_drive(Plant(), Sensor(rate_hz=RATE_HZ), seconds, seed, given_commands=held)


def estimate_at_phase(drive: Drive, phase_s: float, name: str) -> Estimate:
    """The motion estimated from a drive whose take begins `phase_s` (s) after its first command."""
    late = round(phase_s * RATE_HZ)
    seen = drive._replace(
        frame=drive.frame[late:] - late, pose=drive.pose[late:],
        command_time=drive.command_time[::2] - phase_s, command=drive.command[::2],
    )  # fmt: skip
    vehicle = simulated_vehicle()
    return estimate_motion(record_drive(seen, RATE_HZ, vehicle, name), vehicle, TUNING)


def fit_and_score(
    training: Sequence[Estimate], validation: Estimate, names: Sequence[str], seed: int
) -> dict[str, tuple[float, Model]]:
    """NMSE on the validation take, and the model itself, by name, of models fitted with the sample pipeline's settings.

    The NMSE is weighted by the training twists, as in reports.
    """
    settings = tomllib.loads(PIPELINE.read_text())["fit"]
    weights = inverse_spread(np.concatenate([e.twist for e in training]))
    scores, fitted = dict[str, tuple[float, Model]](), dict[str, Model]()
    for name in names:
        row = MODELS[name]
        task = FitTask(training, simulated_vehicle(), settings.get(name, {}), seed, fitted.get(row.base or ""))
        fitted[name] = row.load_class().fit(task)
        predicted: Floats = predict_whole_take(fitted[name], validation)
        scores[name] = (nmse(predicted, validation.twist, weights, validation.period_s).mean, fitted[name])
    return scores


def measure_phases(seconds: float = 150.0) -> dict[str, Any]:
    """NMSE x 1000 of every model by seed and phase, and Newton-Euler's constants with relative standard errors."""
    result: dict[str, Any] = {"nmse_e3": {}, "newton_euler": {}}
    for seed in SEEDS:
        drives = [drive_at_10_hz(seconds, 10 * seed + i) for i in range(5)]
        for phase in PHASES_S:
            *training, validation = [estimate_at_phase(d, phase, f"take {i}") for i, d in enumerate(drives)]
            scores = fit_and_score(training, validation, [n for n, r in MODELS.items() if not r.made_by], seed)
            at = f"seed {seed}, {1e3 * phase:.0f} ms"
            result["nmse_e3"][at] = {name: round(1e3 * score, 3) for name, (score, _) in scores.items()}
            model: Any = scores["newton-euler"][1]
            result["newton_euler"][at] = {
                symbol: [getattr(model.car, symbol, None), about["relative_se"]]
                for symbol, about in model.facts["fitted"].items()
            }
            sys.stderr.write(f"{at} {result['nmse_e3'][at]}\n")
    return result


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(measure_phases(), indent=1) + "\n", encoding="utf-8")

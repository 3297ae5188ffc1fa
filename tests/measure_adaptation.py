"""How fast an adapting car recovers when somebody gets in, beside the model as it was and one that is fitted anew.

    python tests/measure_adaptation.py [SWAPS]

writes docs/results/adaptation.json.  The model is fitted to five minutes of the simulated car with a real car's extras.
In each further drive of four minutes, 20 % of the mass gets in after two.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from bcid.adaptation.adapt import adapt, as_adaptable
from bcid.adaptation.filter import run_filter, start_filter
from bcid.adaptation.recovery import BEFORE_S, HORIZON_S, ErrorsOverTime, errors_over_time, recovery_time_s
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.models.interface import FitTask
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.table import MODELS
from bcid.recording.types import Recording
from bcid.simulation.car import configure_simulation
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

RESULT = Path(__file__).parents[1] / "docs" / "results" / "adaptation.json"
PERIOD_S, LOAD, SWAP_S, SECONDS = 0.05, 0.2, 120.0, 240.0
VEHICLE = simulated_vehicle()


def record(seconds: float, seed: int, *changes: str) -> tuple[Recording, Estimate]:
    """A drive of the simulated car, and its estimated motion."""
    plant, sensor = configure_simulation(False, list(changes), 60.0)
    recording = record_drive(simulate_drive(plant, sensor, seconds, seed), 60.0, VEHICLE)
    return recording, estimate_motion(recording, VEHICLE, TUNING, PERIOD_S)


def fit(estimate: Estimate) -> NewtonEuler:
    """The Newton-Euler model fitted to a drive with the settings of `bcid fit`."""
    row = MODELS["newton-euler"]
    model = row.load_class().fit(FitTask([estimate], VEHICLE, row.defaults, seed=0))
    assert isinstance(model, NewtonEuler)
    return model


def root_mean_square(errors: np.ndarray, begin_s: np.ndarray, begin: float, end: float) -> float:
    """Of the errors of predictions that begin between two times."""
    return float(np.sqrt(np.mean(errors[(begin_s >= begin) & (begin_s < end)] ** 2)))


def measure_swap(model: NewtonEuler, seed: int) -> dict[str, Any]:
    """One swap: when the adapted car has recovered, how well it is weighed, and errors beside other models."""
    recording, estimate = record(SECONDS, seed, f"mass_change={LOAD}", f"mass_change_at={SWAP_S}")
    car = as_adaptable(model, VEHICLE, estimate)
    adapted = adapt(car, ["mass"], recording, estimate)
    errors = errors_over_time(adapted, car, estimate)
    after = estimate.select_rows(slice(int(np.searchsorted(estimate.time_s, SWAP_S)), None))
    anew = as_adaptable(fit(after), VEHICLE, estimate)
    refitted = errors_over_time(adapted, anew, estimate)
    z, P = start_filter(adapted.formulas, adapted.noise, estimate.pose[0], estimate.twist[0], 0.0)
    begun = time.process_time()
    run_filter(adapted.filter, z, P, np.ascontiguousarray(estimate.command[:-1]), adapted.drive.poses[1:])
    cost_s = time.process_time() - begun
    settled = adapted.track.values[estimate.time_s > SWAP_S + BEFORE_S, 0]

    def told(found: ErrorsOverTime, column: str) -> list[float]:
        values = getattr(found, column)
        return [
            round(root_mean_square(values, errors.begin_s, *span), 5)
            for span in ((5.0, SWAP_S - HORIZON_S), (SWAP_S, SWAP_S + BEFORE_S), (SWAP_S + BEFORE_S, SECONDS))
        ]

    return {
        "recovered_after_s": recovery_time_s(errors, SWAP_S), "mass_after": round(float(settled.mean()), 4),
        "share_within_5_percent": round(float((np.abs(settled / (1.0 + LOAD) - 1.0) < 0.05).mean()), 4),
        "real_time_factor": round(float(np.ptp(estimate.time_s)) / cost_s, 1),
        "errors_m": {
            "adapted": told(errors, "adapted"), "frozen": told(errors, "frozen"), "refitted": told(refitted, "frozen"),
        },
    }  # fmt: skip


def main() -> None:
    """Measure some swaps, and write what came of them."""
    model = fit(record(300.0, 1)[1])
    swaps = [measure_swap(model, 100 + i) for i in range(int(sys.argv[1]) if len(sys.argv) > 1 else 10)]
    told = {
        "spans": [
            "before", f"the {BEFORE_S:g} s from the change on", "after these",
        ],
        "recovered_within_20_s": sum(s["recovered_after_s"] is not None and s["recovered_after_s"] < 20 for s in swaps),
        "mean_mass_within_5_percent": sum(abs(s["mass_after"] / (1.0 + LOAD) - 1.0) < 0.05 for s in swaps),
        "below_1.2_refitted_within_20_s": sum(
            s["errors_m"]["adapted"][1] < 1.2 * s["errors_m"]["refitted"][1] for s in swaps
        ),
        "slowest_real_time_factor": min(s["real_time_factor"] for s in swaps),
    }  # fmt: skip
    RESULT.write_text(json.dumps({"load": LOAD, "figures": told, "swaps": swaps}, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(told, indent=1))  # noqa: T201


if __name__ == "__main__":
    main()

"""How fast an adapting car recovers when somebody gets in, beside the model as it was and one that is fitted anew.

    python tests/measure_adaptation.py [SWAPS]

writes docs/results/adaptation.json.  The model is fitted to five minutes of the simulated car with a real car's extras.
In each further drive of four minutes, 20 % of the mass gets in after two.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bcid.adaptation.adapt import Adaptation, adapt, as_adaptable
from bcid.adaptation.filter import run_filter, start_filter
from bcid.adaptation.recovery import errors_over_time
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
# the largest side force of the rear tyres is not reached by the light car, so that no fit knows it
FOLLOWED = (("mass",), ("mass", "F_r_max"))
SPANS = ((0.0, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, 118.0))
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


def measure_swap(model: NewtonEuler, seed: int) -> dict[str, Any]:
    """One swap: masses, and errors of predictions by when they begin, of the car as it was, adapted, fitted anew."""
    recording, estimate = record(SECONDS, seed, f"mass_change={LOAD}", f"mass_change_at={SWAP_S}")
    car = as_adaptable(model, VEHICLE, estimate)
    after = estimate.select_rows(slice(int(np.searchsorted(estimate.time_s, SWAP_S)), None))
    row: dict[str, Any] = {}
    for names in FOLLOWED:
        adapted = adapt(car, names, recording, estimate)
        errors = errors_over_time(adapted, car, estimate)
        settled = adapted.track.values[estimate.time_s > SWAP_S + 20.0, 0]
        row["+".join(names)] = {
            "mass": round(float(settled.mean()), 4), "errors_m": errors.adapted.round(5).tolist(),
            "share_of_masses_within_5_percent": round(float((np.abs(settled / (1.0 + LOAD) - 1.0) < 0.05).mean()), 4),
            "real_time_factor": round(real_time_factor(adapted, estimate), 1),
        }  # fmt: skip
    row["begin_s"] = errors.begin_s.tolist()
    row["frozen_m"] = errors.frozen.round(5).tolist()
    row["refitted_m"] = errors_over_time(adapted, as_adaptable(fit(after), VEHICLE, estimate), estimate).frozen.tolist()
    return row


def real_time_factor(adapted: Adaptation, estimate: Estimate) -> float:
    """How many times as fast as the drive the filter runs over it, in CPU time."""
    z, P = start_filter(adapted.formulas, adapted.noise, estimate.pose[0], estimate.twist[0], 0.0)
    begun = time.process_time()
    run_filter(adapted.filter, z, P, np.ascontiguousarray(estimate.command[:-1]), adapted.drive.poses[1:])
    return float(np.ptp(estimate.time_s)) / (time.process_time() - begun)


def errors_by_span(swaps: list[dict[str, Any]], read: Callable[[dict[str, Any]], list[float]]) -> list[float]:
    """Root mean squares of errors of all swaps by when predictions begin: before the change, and in SPANS after it."""
    begin = np.concatenate([s["begin_s"] for s in swaps]) - SWAP_S
    errors = np.concatenate([read(s) for s in swaps])
    spans = [(5.0 - SWAP_S, -2.0), *SPANS]
    return [round(float(np.sqrt(np.mean(errors[(begin >= a) & (begin < b)] ** 2))), 5) for a, b in spans]


def main() -> None:
    """Measure some swaps, and write what came of them."""
    model = fit(record(300.0, 1)[1])
    swaps = [measure_swap(model, 100 + i) for i in range(int(sys.argv[1]) if len(sys.argv) > 1 else 10)]
    followed = ["+".join(names) for names in FOLLOWED]
    told: dict[str, Any] = {
        "swaps": len(swaps), "spans_s": ["before", *(list(span) for span in SPANS)],
        "frozen_m": errors_by_span(swaps, lambda s: s["frozen_m"]),
        "refitted_m": errors_by_span(swaps, lambda s: s["refitted_m"]),
    }  # fmt: skip
    for name in followed:
        errors = errors_by_span(swaps, lambda s, name=name: s[name]["errors_m"])  # type: ignore[misc]
        told[name] = {
            "errors_m": errors, "times_the_former": [round(e / errors[0], 3) for e in errors],
            "masses_within_5_percent": sum(abs(s[name]["mass"] / (1.0 + LOAD) - 1.0) < 0.05 for s in swaps),
            "slowest_real_time_factor": min(s[name]["real_time_factor"] for s in swaps),
        }  # fmt: skip
    RESULT.write_text(json.dumps({"load": LOAD, "figures": told, "swaps": swaps}) + "\n", encoding="utf-8")
    print(json.dumps(told, indent=1))  # noqa: T201


if __name__ == "__main__":
    main()

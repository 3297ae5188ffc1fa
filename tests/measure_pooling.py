"""How well loads are weighed by pooling drives, and what the pooled car is worth on drives that none was fitted to.

    python tests/measure_pooling.py [FLEETS]

writes docs/results/pooling.json.  Each fleet has twelve drives of 90 s of the simulated car with a real car's extras;
in the last seven somebody sits in it, 5 to 35 % of its mass.  The cars of all drives, of each alone and pooled, are
driven along two further drives without a load, and compared by the position after 2 s.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import position_errors
from bcid.fleet.pool_recordings import fit_recording
from bcid.fleet.pooled_car import pool_car
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car
from bcid.recording.types import Recording
from bcid.simulation.car import configure_simulation
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

RESULT = Path(__file__).parents[1] / "docs" / "results" / "pooling.json"
DRIVES, EMPTY, SECONDS, HELD_OUT, HORIZON_S = 12, 5, 90.0, 2, 2.0
LOADS = (0.05, 0.35)
VEHICLE = simulated_vehicle()


def record(load: float, seed: int) -> tuple[Recording, Estimate]:
    """A drive with a load, as a share of the car's mass, and its estimated motion."""
    plant, sensor = configure_simulation(False, [f"mass_change={load}", "mass_change_at=0"], 60.0)
    recording = record_drive(simulate_drive(plant, sensor, SECONDS, seed), 60.0, VEHICLE)
    return recording, estimate_motion(recording, VEHICLE, TUNING)


def error_m(car: Car, drives: list[Estimate]) -> float:
    """The root mean square error of the position after `HORIZON_S` on some drives."""
    errors = [position_errors(NewtonEuler(car, e.period_s, {}), e, HORIZON_S) for e in drives]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def measure_fleet(fleet: int) -> dict[str, Any]:
    """The loads of one fleet beside what pooling says of them, and the errors of cars on held-out drives."""
    rng = np.random.default_rng(fleet)
    loads = np.r_[np.zeros(EMPTY), rng.uniform(*LOADS, DRIVES - EMPTY)]
    fitted = [fit_recording(*record(load, 1000 * fleet + i), VEHICLE) for i, load in enumerate(loads.tolist())]
    pooled = pool_car([each.summary for each in fitted], ["mass"])
    factors, sd = pooled.factors(list(range(EMPTY)))
    held_out = [record(0.0, 1000 * fleet + 500 + i)[1] for i in range(HELD_OUT)]
    # without a load: the car of the empty drives, of which the reference is the mean
    empty = pooled.pooled.own[:EMPTY, 0].mean()
    shared: Floats = pooled.pooled.shared + pooled.directions[:, 0] * empty
    return {
        "loads": loads.tolist(), "factors": factors[:, 0].tolist(), "sd": sd[:, 0].tolist(),
        "error_pooled_m": error_m(pooled.as_car(shared), held_out),
        "errors_alone_m": [error_m(each.summary.car, held_out) for each in fitted[:EMPTY]],
    }  # fmt: skip


def main() -> None:
    """Measure some fleets, and write what came of it."""
    fleets = [measure_fleet(1 + i) for i in range(int(sys.argv[1]) if len(sys.argv) > 1 else 6)]
    ratio = np.concatenate([np.array(f["factors"][EMPTY:]) / (1.0 + np.array(f["loads"][EMPTY:])) for f in fleets])
    z = np.concatenate([
        (np.array(f["factors"][EMPTY:]) / (1.0 + np.array(f["loads"][EMPTY:])) - 1.0) / np.array(f["sd"][EMPTY:])
        for f in fleets
    ])  # fmt: skip
    alone = [float(np.mean(f["errors_alone_m"])) for f in fleets]
    figures = {
        "loads": len(ratio), "within_3_percent": int((np.abs(ratio - 1.0) < 0.03).sum()),
        "rms_error_percent": round(100.0 * float(np.sqrt(np.mean((ratio - 1.0) ** 2))), 3),
        "within_two_sd": int((np.abs(z) < 2.0).sum()), "fleets": len(fleets),
        "pooled_better_than_mean_alone": sum(f["error_pooled_m"] < a for f, a in zip(fleets, alone, strict=True)),
        "pooled_better_than_each_alone": sum(
            f["error_pooled_m"] < e for f in fleets for e in f["errors_alone_m"]
        ),
        "alone": sum(len(f["errors_alone_m"]) for f in fleets),
        "median_error_pooled_m": round(float(np.median([f["error_pooled_m"] for f in fleets])), 5),
        "median_error_alone_m": round(float(np.median(alone)), 5),
    }  # fmt: skip
    RESULT.write_text(json.dumps({"figures": figures, "fleets": fleets}, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(figures, indent=1))  # noqa: T201


if __name__ == "__main__":
    main()

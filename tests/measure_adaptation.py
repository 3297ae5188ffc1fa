"""How fast an adapting car recovers when somebody gets in, beside the model as it was and one that is fitted anew.

    python tests/measure_adaptation.py [SWAPS]

writes docs/results/adaptation.json.  The model is fitted to five minutes of the simulated car with a real car's extras.
In each further drive of four minutes, 20 % of the mass gets in after two.  The model that is fitted anew sees the first
minute after that, and is judged on the rest.  The goal: from GOAL_S seconds after the change on, errors of predictions
are at most GOAL_RATIO times what they were before, and the mass is within MASS_SHARE of the truth.
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
from bcid.adaptation.filter import start_filter
from bcid.adaptation.filter_run import run_filter
from bcid.adaptation.quantities import release_limits, unreached_limits
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
FOLLOWED = (("mass",), ("mass", "F_r_max"))
REFIT_S = 60.0
SPANS = ((0.0, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, REFIT_S), (REFIT_S, 118.0))
GOAL_S, GOAL_RATIO, MASS_SHARE = 20.0, 1.2, 0.05
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
    first, end = np.searchsorted(estimate.time_s, [SWAP_S, SWAP_S + REFIT_S]).tolist()
    refitted = as_adaptable(fit(estimate.select_rows(slice(first, end))), VEHICLE, estimate)
    since_s = estimate.time_s - SWAP_S
    row: dict[str, Any] = {"released": unreached_limits(model)}
    for names in FOLLOWED:
        released = release_limits(car, [limit for limit in row["released"] if limit not in names])
        adapted = adapt(released, names, recording, estimate)
        errors = errors_over_time(adapted, car, estimate)
        mass, sd = adapted.track.values[:, 0], adapted.track.sd[:, 0]
        right, late = np.abs(mass / (1.0 + LOAD) - 1.0) < MASS_SHARE, since_s > GOAL_S
        # once the swap, which the filter does not know of, is learnt; and before it
        apart = np.where(since_s < 0.0, mass - 1.0, mass - 1.0 - LOAD) / sd
        stated = (since_s < 0.0) & (estimate.time_s > GOAL_S) | late
        row["+".join(names)] = {
            "mass": round(float(mass[late].mean()), 4), "errors_m": errors.adapted.round(5).tolist(),
            "share_of_moments_with_right_mass": round(float(right[late].mean()), 4),
            "share_within_two_sd": round(float((np.abs(apart[stated]) < 2.0).mean()), 4),
            "first_right_s": round(float(since_s[right & (since_s > 0.0)].min(initial=np.inf)), 2),
            # from the last moment at which it is not
            "right_to_the_end_from_s": round(float(since_s[~right].max(initial=0.0)), 2),
            "real_time_factor": round(real_time_factor(adapted, estimate), 1),
        }  # fmt: skip
    row["begin_s"] = errors.begin_s.tolist()
    row["frozen_m"] = errors.frozen.round(5).tolist()
    row["refitted_m"] = errors_over_time(adapted, refitted, estimate).frozen.round(5).tolist()
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


def summarise(swaps: list[dict[str, Any]], followed: str, figure: str) -> dict[str, float]:
    """The least, the median and the largest of a `figure` over all swaps, where the car is `followed`."""
    drawn = [s[followed][figure] for s in swaps]
    return {"least": min(drawn), "median": round(float(np.median(drawn)), 4), "largest": max(drawn)}


def main() -> None:
    """Measure some swaps, and write what came of them."""
    model = fit(record(300.0, 1)[1])
    swaps = [measure_swap(model, 100 + i) for i in range(int(sys.argv[1]) if len(sys.argv) > 1 else 24)]
    followed = ["+".join(names) for names in FOLLOWED]
    told: dict[str, Any] = {
        "swaps": len(swaps), "spans_s": ["before", *(list(span) for span in SPANS)],
        "frozen_m": errors_by_span(swaps, lambda s: s["frozen_m"]),
        # over the last span alone: it was fitted to those before
        "refitted_m": errors_by_span(swaps, lambda s: s["refitted_m"])[-1],
        "goal": {"after_s": GOAL_S, "times_the_former": GOAL_RATIO, "mass_within": MASS_SHARE},
    }  # fmt: skip
    for name in followed:
        errors = errors_by_span(swaps, lambda s, name=name: s[name]["errors_m"])  # type: ignore[misc]
        times = [round(e / errors[0], 3) for e in errors]
        late = [ratio for ratio, (begin, _) in zip(times[1:], SPANS, strict=True) if begin >= GOAL_S]
        told[name] = {
            "errors_m": errors, "times_the_former": times, "reaches_the_goal": max(late) <= GOAL_RATIO,
            "share_of_moments_with_right_mass": summarise(swaps, name, "share_of_moments_with_right_mass"),
            "share_within_two_sd": summarise(swaps, name, "share_within_two_sd"),
            "first_right_s": summarise(swaps, name, "first_right_s"),
            "right_to_the_end_from_s": summarise(swaps, name, "right_to_the_end_from_s"),
            "slowest_real_time_factor": min(s[name]["real_time_factor"] for s in swaps),
        }  # fmt: skip
    RESULT.write_text(json.dumps({"load": LOAD, "figures": told, "swaps": swaps}) + "\n", encoding="utf-8")
    print(json.dumps(told, indent=1))  # noqa: T201


if __name__ == "__main__":
    main()

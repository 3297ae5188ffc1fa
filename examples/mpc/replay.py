"""Drives the simulated car by the plans of each model, and writes what came of it; --help says how it is run."""

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import scene
from car import SimulatedCar
from drives import ParkingDrive, drive
from exported import Predictor, load_predictor
from figures import summarise
from observer import Observer
from problem import ParkingProblem, Plan

from bcid.simulation.car import configure_simulation

MODELS = ("augmented", "unaugmented", "linear")
CONCEALED = ("steering_delay=0.15", "steering_nonlinearity=-0.02", "rear_rolling_coulomb=40")
"""What the car has that the paper's model lacks, as `bcid simulate --set` takes it."""
HORIZONS_S = (0.1, 1.0, 2.0)
"""Times (s) after which predictions are compared with what happened."""
FIRST_SEED, STARTS = 101, 12
"""Starts that the controllers were not made with: theirs had seeds below 100."""


def place_car(seed: int) -> SimulatedCar:
    """The simulated car at rest, its start, floor and noise drawn from `seed`."""
    plant, sensor = configure_simulation(ideal=False, changes=CONCEALED, rate_hz=60.0)
    return SimulatedCar(plant, sensor, scene.draw_start(seed), seed)


def follow_blindly(problem: ParkingProblem, first: Plan, seed: int) -> tuple[float, float]:
    """How far from where its `first` plan ends the car of `seed` comes if it is sent the whole plan, and nobody looks.

    Returns the distance (m) and the difference in heading (degrees).
    """
    car = place_car(seed)
    car.advance(np.zeros(2), problem.period_s)
    for u in first.u.T:
        car.advance(u, problem.period_s)
    off = car.pose - first.z[:3, -1]
    return math.hypot(off[0], off[1]), abs(math.degrees(math.remainder(off[2], 2.0 * math.pi)))


def prediction_errors(model: Predictor, seen: np.ndarray, pose: np.ndarray, u: np.ndarray) -> dict[float, np.ndarray]:
    """Distances (m) of predicted from true positions, by the time ahead: from each row of a drive on, where it lasts.

    An observer of `model` follows the measured poses `seen` (K + 1, 3); from its state at each row the commands
    `u` (K, 2) that were sent are driven.  `pose` (K + 1, 3) is the truth.
    """
    observer, states = Observer(model, seen[0]), []
    for k in range(len(u)):
        states.append(observer.z)
        observer.predict(u[k])
        observer.update(seen[k + 1])
    errors = {}
    for ahead_s in HORIZONS_S:
        count = round(ahead_s / model.period_s)
        many = model.step.mapaccum(count)
        rows = range(len(u) - count + 1)
        ends = [np.asarray(many(states[k], u[k : k + count].T))[:2, -1] for k in rows]
        errors[ahead_s] = np.array([np.hypot(*(end - pose[k + count, :2])) for k, end in zip(rows, ends, strict=True)])
    return errors


def describe_drive(model: str, seed: int, problem: ParkingProblem, d: ParkingDrive) -> dict[str, Any]:
    """The figures of one drive, and its track."""
    distance, turn = scene.goal_errors(d.pose[-1])
    standing = np.zeros((len(problem.model.states), len(d.pose)))
    standing[:3] = d.pose.T
    cost = float(np.asarray(problem.stage(standing)).sum() * problem.model.period_s)
    way = np.diff(d.pose[:, :2], axis=0)
    heading = d.pose[:-1, 2]
    blind_m, blind_deg = follow_blindly(problem, d.plans[0], seed)
    ahead = way[:, 0] * np.cos(heading) + way[:, 1] * np.sin(heading)
    return {
        "model": model, "seed": seed, "parked": d.parked, "time_s": round(len(d.command) * problem.model.period_s, 3),
        "position_error_m": distance, "heading_error_deg": float(np.degrees(turn)), "cost_m_s": cost,
        "clearance_m": float(min(map(scene.measure_clearance, d.pose))),
        "backward_m": float(-ahead[ahead < 0.0].sum()), "largest_servo_deg": float(np.degrees(np.abs(d.servo).max())),
        "beyond_90_deg_s": float((np.abs(d.servo) > 0.5 * np.pi).sum() * problem.model.period_s),
        "blind_m": blind_m,
        "blind_deg": blind_deg,
        "plan_s": d.plan_s.tolist(),
        "track": np.round(np.column_stack([d.pose, d.servo]), 4).tolist(),
    }  # fmt: skip


def main() -> None:
    """Drive all models from all starts, and write the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", type=Path, help="the folder that `bcid export` has written")
    parser.add_argument("--out", type=Path, required=True, help="the JSON to write")
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="seed of the first start")
    parser.add_argument("--starts", type=int, default=STARTS)
    parser.add_argument("--only", choices=MODELS, action="append", help="drive by this model alone; repeat for several")
    asked = parser.parse_args()
    if asked.out.exists():
        parser.error(f"{asked.out} exists: name another file")
    problems = {name: ParkingProblem(load_predictor(asked.models, name)) for name in asked.only or MODELS}
    everyone = [load_predictor(asked.models, name) for name in MODELS]
    rows: list[dict[str, Any]] = []
    for seed in range(asked.first, asked.first + asked.starts):
        for name, problem in problems.items():
            d = drive(problem, place_car(seed))
            row = describe_drive(name, seed, problem, d)
            # one set of drives for all models' predictions: those that the augmented model steered
            if name == "augmented":
                row["predictions_m"] = {
                    model.name: {
                        f"{t:g} s": float(np.sqrt(np.mean(e**2)))
                        for t, e in prediction_errors(model, d.seen, d.pose, d.command).items()
                    }
                    for model in everyone
                }
            rows.append(row)
            print(f"{name} {seed}: {'parked' if d.parked else 'not parked'} {row['time_s']:.1f} s", flush=True)  # noqa: T201
    asked.out.write_text(json.dumps(summarise(rows, CONCEALED), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

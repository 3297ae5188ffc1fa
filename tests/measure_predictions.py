"""How often the 95 % intervals of predictions hold, on simulated takes that no model was made from.

`python tests/measure_predictions.py` drives two simulated cars, the paper's and one with a real car's extras, fits
models to takes of each and predicts a held-out take from many moments, all with several draws of drives and noise.
It writes docs/results/predictions.json, which docs/python.md shows.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest

from bcid.aliases import Bools
from bcid.diagnosis.diagnose import diagnose_recordings
from bcid.diagnosis.judge.fitted_models import model_from_fit
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.evaluation.noise_covariance import NORMAL_FACTOR
from bcid.evaluation.process_noise import list_prediction_starts
from bcid.evaluation.validity import ModelValidity
from bcid.models.interface import FitTask, Model
from bcid.models.table import model_row
from bcid.pipeline.config import FitTables
from bcid.prediction.fitted_model import FittedModel
from bcid.prediction.start import Moment
from bcid.recording.types import Recording
from bcid.simulation.car import configure_simulation
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

RESULTS = Path(__file__).parents[1] / "docs" / "results" / "predictions.json"
SECONDS = 150.0
DRAWS = ((21, 22, 23), (31, 32, 33), (41, 42, 43), (51, 52, 53))
"""Seeds of the takes: those of the fit, and last the one that is held out."""
HORIZONS_S = (0.5, 2.0, 5.0)
RATE_HZ = 60.0
DIAGNOSED = "newton-euler-augmented"


class Car(NamedTuple):
    """A simulated car and the models that are fitted to its takes, by name and loss."""

    name: str
    ideal: bool
    changes: tuple[str, ...]
    models: tuple[tuple[str, str], ...]


CARS = (
    Car("the paper's car", True, (), (("newton-euler", "one-step"), ("newton-euler", "poses"))),
    Car(
        "a real car's extras",
        False,
        ("steering_delay=0.05",),
        (("newton-euler", "one-step"), ("newton-euler", "poses"), ("k-sindy", "one-step"), (DIAGNOSED, "")),
    ),
)


def drive(car: Car, seed: int) -> tuple[Recording, Estimate]:
    """A take of a car, and the motion that is estimated from it."""
    plant, sensor = configure_simulation(car.ideal, list(car.changes), RATE_HZ)
    recording = record_drive(simulate_drive(plant, sensor, SECONDS, seed), RATE_HZ, simulated_vehicle())
    return recording, estimate_motion(recording, simulated_vehicle(), TUNING)


def fit(name: str, loss: str, takes: list[tuple[Recording, Estimate]]) -> Model:
    """A model fitted to takes, by a diagnosis of them if it is the car with effects."""
    recordings, estimates = [r for r, _ in takes], [e for _, e in takes]
    if name == DIAGNOSED:
        found = diagnose_recordings(recordings, estimates, simulated_vehicle(), None, lambda share, text: None)
        return model_from_fit(found.fit, float(found.take.length_s[0]), estimates[0].period_s)
    table = getattr(FitTables(), name.replace("-", "_")).model_copy(update={"loss": loss})
    settings = table.model_dump(mode="json", by_alias=True)
    task = FitTask(estimates, simulated_vehicle(), settings, 1, None, recordings)
    return model_row(name).load_class().fit(task)


def starts_within(fitted: FittedModel, estimate: Estimate, horizon_s: float) -> Bools:
    """Whether each number of pose and twist (S, 6) lies in its 95 % interval after a time, from S starts as far apart.

    What is compared with is measured, so that its own error widens the interval.
    """
    n = round(horizon_s / estimate.period_s)
    noise = TUNING.noise
    pose_sd = np.array([noise.r_position, noise.r_position, noise.r_yaw])
    within = list[Bools]()
    for e, k in list_prediction_starts([estimate], n, max(n, 10), fitted.model.lags):
        prediction = fitted.predict_quietly(None, Moment(e, float(e.time_s[k])), horizon_s)
        measured = np.concatenate([e.pose[k + n], e.twist[k + n]])
        sd = np.hypot(prediction.sd[-1], np.concatenate([pose_sd, e.twist_sd[k + n]]))
        off = measured - np.concatenate([prediction.pose[-1], prediction.twist[-1]])
        within.append(np.abs(off) <= NORMAL_FACTOR * sd)
    return np.array(within)


def summarise(draws: list[Bools]) -> dict[str, Any]:
    """The shares that lie within, over all draws and in each."""
    table = np.concatenate(draws)
    share = float(table.mean())
    # each start counts once: its six numbers go wrong together
    low, high = binomtest(round(share * len(table)), len(table)).proportion_ci(0.95, "wilson")
    return {
        "starts": len(table), "covered": share, "ci95": [float(low), float(high)],
        "pose": float(table[:, :3].mean()), "twist": float(table[:, 3:].mean()),
        "draws": [round(float(within.mean()), 4) for within in draws],
    }  # fmt: skip


def measure_draw(car: Car, seeds: tuple[int, ...]) -> dict[tuple[str, str, float], Bools]:
    """What lies within, of each model, loss and horizon: models of the takes of all `seeds` but the last."""
    *takes, (_, held_out) = [drive(car, seed) for seed in seeds]
    estimates = [e for _, e in takes]
    found = {}
    for name, loss in car.models:
        model = fit(name, loss, takes)
        fitted = FittedModel(model, ModelValidity.measure(model, estimates, 1), Path(name), "")
        for horizon_s in HORIZONS_S:
            found[name, loss, horizon_s] = starts_within(fitted, held_out, horizon_s)
            print(car.name, seeds, name, loss, horizon_s, found[name, loss, horizon_s].mean(), flush=True)  # noqa: T201
    return found


def measure() -> dict[str, Any]:
    """The coverage of all models of all cars at all horizons."""
    rows = []
    for car in CARS:
        draws = [measure_draw(car, seeds) for seeds in DRAWS]
        for name, loss, horizon_s in draws[0]:
            row = {"car": car.name, "model": name, "loss": loss, "horizon_s": horizon_s}
            rows.append(row | summarise([draw[name, loss, horizon_s] for draw in draws]))
    return {"seconds": SECONDS, "training_takes": len(DRAWS[0]) - 1, "rows": rows}


if __name__ == "__main__":
    RESULTS.write_text(json.dumps(measure(), indent=1) + "\n", encoding="utf-8")

"""How often the constants of a simulated car lie in the intervals that a fit states for them."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numba
import numpy as np

from bcid.bench.limits import RECOVERY
from bcid.bench.run import SCHEMA
from bcid.estimate.run import estimate_motion
from bcid.models.fitting.block_covariance import Z_95
from bcid.models.interface import FitTask
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import is_identified
from bcid.models.settings import LOSSES, NewtonEulerSettings
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

PLANT_FIELDS = {
    "F_m_max": "motor_limit", "K_t": "motor_gain", "K_b": "brake_gain", "I_z": "inertia", "C_f": "front_stiffness",
    "C_r": "rear_stiffness", "F_f_max": "front_grip", "F_r_max": "rear_grip", "R_1": "rolling_drag",
}  # fmt: skip
"""Fields of the simulated car's plant, by the symbols of the fitted car."""


def fit_simulated_take(seed: int, seconds: float, losses: Sequence[str] = LOSSES) -> list[dict[str, Any]]:
    """Fit a Newton-Euler car by each of `losses` to a simulated drive of `seconds`, whose car has known constants.

    Returns a row for each loss and identified constant: "loss", "seed", "symbol", "off" (fitted / true - 1) and
    "relative_se" (the standard error that the fit states / the fitted value).
    """
    plant, vehicle = Plant(), simulated_vehicle()
    recording = record_drive(simulate_drive(plant, Sensor(), seconds, seed), 60.0, vehicle)
    estimate, rows = estimate_motion(recording, vehicle, TUNING), []
    for loss in losses:
        settings = NewtonEulerSettings(loss=loss).model_dump()  # type: ignore[arg-type]
        model = NewtonEuler.fit(FitTask([estimate], vehicle, settings, seed, recordings=[recording]))
        for symbol, name in PLANT_FIELDS.items():
            if not is_identified(symbol, model.facts):
                continue
            off = getattr(model.car, symbol) / getattr(plant, name) - 1.0
            se = model.facts["fitted"][symbol]["relative_se"]
            rows.append({"loss": loss, "seed": seed, "symbol": symbol, "off": off, "relative_se": se})
    return rows


def fit_simulated_takes(fits: int, seconds: float, seed: int, cores: int) -> Iterator[list[dict[str, Any]]]:
    """Yield, drive by drive, the rows of `fit_simulated_take` for `fits` simulated drives of `seconds` each.

    Their seeds are `seed`, `seed` + 1 and so on; the fits run in `cores` processes.
    """
    with ProcessPoolExecutor(cores, get_context("spawn"), numba.set_num_threads, (1,)) as pool:
        yield from pool.map(fit_simulated_take, range(seed, seed + fits), [seconds] * fits)


def summarise_recovery(rows: Sequence[Mapping[str, Any]], about: Mapping[str, Any]) -> dict[str, Any]:
    """The parameter benchmark's JSON: how well fits recover known constants, for each loss and constant and for "all".

    From `rows` of `fit_simulated_take`: the share of 95 % intervals that hold the true constant, the median relative
    error, the median (bias) and RMS of errors in standard errors, the goal missed.  `about` is taken over as it is.
    """
    table = []
    for loss in dict.fromkeys(r["loss"] for r in rows):
        mine = [r for r in rows if r["loss"] == loss]
        for symbol in ("all", *PLANT_FIELDS):
            chosen = [r for r in mine if symbol in ("all", r["symbol"])]
            off, se = np.array([r["off"] for r in chosen]), np.array([r["relative_se"] for r in chosen])
            row = {"loss": loss, "symbol": symbol, "n": len(chosen)}
            if chosen:
                row |= {
                    "covered": float((np.abs(off) <= Z_95 * se).mean()),
                    "median_error": float(np.median(np.abs(off))),
                    "bias_in_errors": float(np.median(off / se)),
                    "rms_in_errors": float(np.sqrt(np.mean((off / se) ** 2))),
                }
            table.append(row)
    covered = next(r for r in table if (r["loss"], r["symbol"]) == ("poses", "all"))["covered"]
    low, high = RECOVERY.coverage
    missed = [] if low <= covered <= high else [f"95 % intervals hold {100 * covered:.0f} %"]
    return {"schema": SCHEMA, "what": "parameters", **about, "rows": table, "missed": missed}

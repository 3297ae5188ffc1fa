"""How often the constants of a simulated car lie in the intervals that a fit states of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numba
import numpy as np

from bcid.bench.run import SCHEMA
from bcid.estimate.run import estimate_motion
from bcid.models.fitting.block_covariance import TWO_SIDED
from bcid.models.interface import FitTask
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import identified
from bcid.models.settings import LOSSES, NewtonEulerSettings
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import drive
from bcid.virtual_lab import TUNING, recorded, vehicle

TRUE = {
    "F_m_max": "motor_limit", "K_t": "motor_gain", "K_b": "brake_gain", "I_z": "inertia", "C_f": "front_stiffness",
    "C_r": "rear_stiffness", "F_f_max": "front_grip", "F_r_max": "rear_grip", "R_1": "rolling_drag",
}  # fmt: skip
"""The constants of the simulated car, by the symbols of the fitted one."""

GOAL = (0.90, 0.98)  # of the 95 % intervals of the fit to poses


def fitted(seed: int, seconds: float, losses: Sequence[str] = LOSSES) -> list[dict[str, Any]]:
    """One take of the paper's car, all of which the model has, fitted by each loss: the errors of its constants."""
    plant, of = Plant(), vehicle()
    recording = recorded(drive(plant, Sensor(), seconds, seed), 60.0, of)
    estimate, found = estimate_motion(recording, of, TUNING), []
    for loss in losses:
        settings = NewtonEulerSettings(loss=loss).model_dump()  # type: ignore[arg-type]
        model = NewtonEuler.fit(FitTask([estimate], of, settings, seed, recordings=[recording]))
        for symbol, name in TRUE.items():
            if not identified(symbol, model.facts):
                continue
            off = getattr(model.car, symbol) / getattr(plant, name) - 1.0
            se = model.facts["fitted"][symbol]["relative_se"]
            found.append({"loss": loss, "seed": seed, "symbol": symbol, "off": off, "relative_se": se})
    return found


def recovery(fits: int, seconds: float, seed: int, cores: int) -> Iterator[list[dict[str, Any]]]:
    """`fitted` of so many takes, one after the other."""
    with ProcessPoolExecutor(cores, get_context("spawn"), numba.set_num_threads, (1,)) as pool:
        yield from pool.map(fitted, range(seed, seed + fits), [seconds] * fits)


def outcome(rows: Sequence[Mapping[str, Any]], about: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON: of each loss, how often the truth lies in the 95 % interval, the bias and the error, by constant."""
    table = []
    for loss in dict.fromkeys(r["loss"] for r in rows):
        mine = [r for r in rows if r["loss"] == loss]
        for symbol in ("all", *TRUE):
            some = [r for r in mine if symbol in ("all", r["symbol"])]
            off, se = np.array([r["off"] for r in some]), np.array([r["relative_se"] for r in some])
            told = {"loss": loss, "symbol": symbol, "n": len(some)}
            if some:
                told |= {
                    "covered": float((np.abs(off) <= TWO_SIDED * se).mean()),
                    "median_error": float(np.median(np.abs(off))),
                    "bias_in_errors": float(np.median(off / se)),
                    "rms_in_errors": float(np.sqrt(np.mean((off / se) ** 2))),
                }
            table.append(told)
    held = next(r for r in table if (r["loss"], r["symbol"]) == ("poses", "all"))["covered"]
    missed = [] if GOAL[0] <= held <= GOAL[1] else [f"95 % intervals hold {100 * held:.0f} %"]
    return {"schema": SCHEMA, "what": "parameters", **about, "rows": table, "missed": missed}

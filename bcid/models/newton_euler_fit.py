"""Fitting the Newton-Euler model's constants to one-step predictions of the twist."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numba
import numpy as np

from bcid.compiled import njit, njit_parallel
from bcid.models.genetic import Optimum, minimise
from bcid.models.interface import FitTask, Floats
from bcid.models.samples import Transitions, scale, transitions
from bcid.physics.car import Car, advance
from bcid.vehicle import Vehicle

GRAVITY = 9.81
UNIDENTIFIED = 0.5  # relative standard error
NEAR_BOUND = 0.01  # share of the (logarithmic) range


class Parameter(NamedTuple):
    """One constant to be fitted, searched between `low` and `high` on a logarithmic scale."""

    symbol: str
    unit: str
    low: float
    high: float
    meaning: str


def parameters(vehicle: Vehicle, top_speed_mps: float) -> tuple[Parameter, ...]:
    """The fitted constants and their ranges, which scale with the vehicle's mass and size.

    Drag is searched as R_1 and as the slope R_v = R_1 + R_2 v at the fastest speed driven: both are
    positive, so the fitted drag dissipates at every speed that was driven (errata 6).
    """
    m = vehicle.mass_kg
    arm = vehicle.body.cog_to_front_m * vehicle.body.cog_to_rear_m
    speed = (
        Parameter("F_m_max", "N", 0.05 * m, 1.0 * m * GRAVITY, "maximum motor force"),
        Parameter("K_t", "N s/m", 0.05 * m, 30.0 * m, "throttle gain"),
    )
    force = (
        Parameter("K_t", "N", 0.1 * m, 50.0 * m, "throttle gain"),
        Parameter("u_0", "-", 1e-3, 0.5, "throttle dead zone"),
        Parameter("K_v", "N s/m", 1e-3 * m, 10.0 * m, "loss of motor force with speed"),
    )
    return (
        *(speed if vehicle.motor.law == "speed" else force),
        Parameter("K_b", "N s/m", 0.01 * m, 20.0 * m, "brake gain"),
        Parameter("I_z", "kg m²", 0.2 * m * arm, 6.0 * m * arm, "moment of inertia"),
        Parameter("C_f", "N/rad", 0.5 * m, 200.0 * m, "front cornering stiffness"),
        Parameter("C_r", "N/rad", 0.5 * m, 200.0 * m, "rear cornering stiffness"),
        Parameter("F_f_max", "N", 0.02 * m * GRAVITY, 1.0 * m * GRAVITY, "maximum front side force"),
        Parameter("F_r_max", "N", 0.02 * m * GRAVITY, 1.0 * m * GRAVITY, "maximum rear side force"),
        Parameter("R_1", "N s/m", 1e-3 * m, 5.0 * m, "linear drag"),
        Parameter("R_v", "N s/m", 1e-3 * m, 5.0 * m, f"drag per speed at {top_speed_mps:.2f} m/s"),
    )


@njit
def _one_step_cost(
    p: Car, twist: Floats, delta: Floats, command: Floats, after: Floats, weight: Floats, period: float
) -> float:
    """Mean squared weighted error of the twist one period ahead (paper, lossv)."""
    total = 0.0
    for k in range(len(twist)):
        v_x, v_y, omega, _ = advance(
            (twist[k, 0], twist[k, 1], twist[k, 2], delta[k]), command[k, 0], command[k, 1], p, period
        )
        e_x = weight[0] * (v_x - after[k, 0])
        e_y = weight[1] * (v_y - after[k, 1])
        e_w = weight[2] * (omega - after[k, 2])
        total += e_x * e_x + e_y * e_y + e_w * e_w
    return total / (3 * len(twist))


@njit
def one_step_predictions(p: Car, twist: Floats, delta: Floats, command: Floats, period: float) -> Floats:
    """Twists (N, 3) one period ahead."""
    out = np.empty((len(twist), 3))
    for k in range(len(twist)):
        start = (twist[k, 0], twist[k, 1], twist[k, 2], delta[k])
        out[k, 0], out[k, 1], out[k, 2], _ = advance(start, command[k, 0], command[k, 1], p, period)
    return out


@njit_parallel
def _costs(
    cars: list[Car], twist: Floats, delta: Floats, command: Floats, after: Floats, weight: Floats, period: float
) -> Floats:
    out = np.empty(len(cars))
    for i in numba.prange(len(cars)):
        out[i] = _one_step_cost(cars[np.int64(i)], twist, delta, command, after, weight, period)
    return out


def car_from(values: Mapping[str, float], vehicle: Vehicle, T_s: float, d: float, v_0: float, top_speed: float) -> Car:
    """All constants from the fitted ones (`parameters`) and the vehicle file's."""
    body = vehicle.body
    fitted = dict(values)
    R_v = fitted.pop("R_v")
    fitted.setdefault("F_m_max", 1e3 * vehicle.mass_kg * GRAVITY)  # law "force" has no limit of its own
    return Car(
        m=vehicle.mass_kg, l_f=body.cog_to_front_m, l_r=body.cog_to_rear_m, T_s=T_s, d=d, v_0=v_0,
        R_2=(R_v - fitted["R_1"]) / top_speed, front_share=vehicle.front_share,
        sets_force=1.0 if vehicle.motor.law == "force" else 0.0, **fitted,
    )  # fmt: skip


def fit_car(task: FitTask) -> tuple[Car, dict[str, Any]]:
    """The car whose one-step predictions are best, and how it was found.

    Settings: `GeneticSettings`.
    """
    samples: Transitions = transitions(task.estimates)
    weight = scale(samples.twist[:, 0])
    top_speed = float(np.quantile(samples.kinematic[:, 0], 0.999))
    table = parameters(task.vehicle, top_speed)
    low, high = np.log([[p.low, p.high] for p in table]).T
    steering = task.estimates[0].facts
    v_0 = float(task.settings["v_0_mps"])

    def car_at(genes: Floats) -> Car:
        values = np.exp(low + genes * (high - low))
        named = dict(zip((p.symbol for p in table), values.tolist(), strict=True))
        return car_from(named, task.vehicle, steering["T_s"], steering["d"], v_0, top_speed)

    twist, command = np.ascontiguousarray(samples.twist[:, 0]), np.ascontiguousarray(samples.command[:, 0])
    delta = np.ascontiguousarray(samples.kinematic[:, 3])

    def costs(people: Floats) -> Floats:
        cars = numba.typed.List([car_at(genes) for genes in people])
        found = np.asarray(_costs(cars, twist, delta, command, samples.next_twist, weight, task.period_s))
        return np.where(np.isfinite(found), found, 1e12)

    best = minimise(
        costs, len(table), int(task.settings["population"]), int(task.settings["generations"]), task.seed, task.progress
    )
    car = car_at(best.x)

    def weighted(genes: Floats) -> Floats:
        return np.asarray(weight * one_step_predictions(car_at(genes), twist, delta, command, task.period_s)).ravel()

    relative_se = _relative_errors(weighted, best, high - low)
    edge = [p.symbol for p, gene in zip(table, best.x, strict=True) if min(gene, 1 - gene) < NEAR_BOUND]
    facts = {
        "optimiser": f"genetic algorithm, {task.settings['population']} individuals, {len(best.history)} generations",
        "one_step_nmse": best.cost,
        "history": best.history,
        "fitted": {
            p.symbol: {"unit": p.unit, "low": p.low, "high": p.high, "meaning": p.meaning, "relative_se": se}
            for p, se in zip(table, relative_se, strict=True)
        },
        "at_bound": edge,
        "top_speed_mps": top_speed,
        "mass_given": task.vehicle.body.mass_kg is not None,
    }
    return car, facts


def _relative_errors(weighted: Callable[[Floats], Floats], best: Optimum, log_range: Floats) -> list[float | None]:
    """Relative standard error of each constant by the Jacobian at the optimum; None where it has no effect.

    The residuals are taken as independent, which smoothed velocities are not: the errors are the least.
    """
    n, step = len(best.x), 1e-4
    columns = []
    for i in range(n):
        ahead, behind = best.x.copy(), best.x.copy()
        ahead[i] += step
        behind[i] -= step
        columns.append((weighted(ahead) - weighted(behind)) / (2.0 * step))
    J = np.column_stack(columns)
    acting = np.sqrt((J**2).mean(axis=0)) > 1e-6
    spread = np.full(n, np.nan)
    normal = J[:, acting].T @ J[:, acting]
    spread[acting] = np.sqrt(np.diag(np.linalg.pinv(normal)) * best.cost)
    return [float(s) if np.isfinite(s) else None for s in spread * log_range]


def _told(name: str, value: float, fitted: Mapping[str, Any], at_bound: Sequence[str]) -> str:
    """One line of the table of constants."""
    error = fitted["relative_se"]
    if error is None or error > UNIDENTIFIED or name in at_bound:
        why = "at its bound" if name in at_bound else "the takes do not show it"
        return f"  {name:10}* not identified       {fitted['unit']:7} {fitted['meaning']} ({why})"
    return f"  {name:10}* = {value:<10.4g} ±{100 * error:<5.2g}% {fitted['unit']:7} {fitted['meaning']}"


def parameter_lines(car: Car, facts: Mapping[str, Any]) -> list[str]:
    """The table of constants, one per line: value, least standard error, unit, meaning; fitted ones carry a *."""
    fitted = facts.get("fitted", {})
    values = car._asdict() | {"R_v": car.R_1 + car.R_2 * facts.get("top_speed_mps", 0.0)}
    lines = [_told(s, values[s], p, facts["at_bound"]) for s, p in fitted.items()]
    lines.append(f"  {'R_2':11} = {car.R_2:<10.4g}        N s²/m² from R_1 and R_v, so that the drag dissipates")
    given = {"m": "kg", "l_f": "m", "l_r": "m", "T_s": "s", "d": "rad/s", "v_0": "m/s", "front_share": "-"}
    lines += [f"  {s:11} = {values[s]:<10.4g}        {unit:7} held" for s, unit in given.items()]
    lines.append("  m, I_z and all forces scale together: m is held")
    if not facts.get("mass_given", True):
        lines.append("  the mass is not given: m = 1 kg, forces read as accelerations")
    return lines

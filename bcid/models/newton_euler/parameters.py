"""The Newton-Euler model's constants that a fit chooses: their ranges, how they make a car, how they are told."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.physics.car import Car
from bcid.vehicle import Vehicle

GRAVITY = 9.81
UNIDENTIFIED = 0.5  # relative standard error
LIMITS = ("F_m_max", "F_f_max", "F_r_max")  # where a force is cut off: a take that never reaches one has no slope there
TIED = 0.95  # correlation from which two constants are told to go together
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


@dataclass(frozen=True)
class Box:
    """The ranges as the unit box: a point x in it is a car."""

    vehicle: Vehicle
    T_s: float
    d: float
    v_0: float
    top_speed: float  # m/s, the fastest driven

    @cached_property
    def table(self) -> tuple[Parameter, ...]:
        """The constants, one for each coordinate."""
        return parameters(self.vehicle, self.top_speed)

    @cached_property
    def log_range(self) -> Floats:
        """By how much each constant's logarithm grows across the box."""
        return np.log([p.high / p.low for p in self.table])

    def car(self, x: Floats) -> Car:
        """The car at a point of the box."""
        values = [p.low * np.exp(g * r) for p, g, r in zip(self.table, x, self.log_range, strict=True)]
        named = {p.symbol: float(v) for p, v in zip(self.table, values, strict=True)}
        return car_from(named, self.vehicle, self.T_s, self.d, self.v_0, self.top_speed)

    def at_bound(self, x: Floats) -> list[str]:
        """The constants that stand at an end of their ranges."""
        return [p.symbol for p, g in zip(self.table, x, strict=True) if min(g, 1.0 - g) < NEAR_BOUND]


def correlated(covariance: Floats, symbols: Sequence[str]) -> list[tuple[str, str, float]]:
    """Pairs of constants whose errors go together."""
    sd = np.sqrt(np.diag(covariance))
    rho = covariance / np.outer(sd, sd)
    return [
        (symbols[i], symbols[j], float(rho[i, j]))
        for i, j in itertools.combinations(range(len(symbols)), 2)
        if abs(rho[i, j]) > TIED
    ]


def identified(symbol: str, facts: Mapping[str, Any]) -> bool:
    """Whether the takes show a fitted constant, or leave it at its bound or unknown to half of itself."""
    error = facts["fitted"][symbol]["relative_se"]
    return error is not None and error <= UNIDENTIFIED and symbol not in facts["at_bound"]


def _told(name: str, value: float, facts: Mapping[str, Any]) -> str:
    """One line of the table of constants."""
    fitted = facts["fitted"][name]
    error = fitted["relative_se"]
    if not identified(name, facts):
        why = "at its bound" if name in facts["at_bound"] else "the takes do not show it"
        return f"  {name:10}* not identified       {fitted['unit']:7} {fitted['meaning']} ({why})"
    return f"  {name:10}* = {value:<10.4g} ±{100 * error:<5.2g}% {fitted['unit']:7} {fitted['meaning']}"


def parameter_lines(car: Car, facts: Mapping[str, Any]) -> list[str]:
    """The table of constants, one per line: value, standard error, unit, meaning; fitted ones carry a *."""
    fitted = facts.get("fitted", {})
    values = car._asdict() | {"R_v": car.R_1 + car.R_2 * facts.get("top_speed_mps", 0.0)}
    lines = [_told(s, values[s], facts) for s in fitted]
    lines.append(f"  {'R_2':11} = {car.R_2:<10.4g}        N s²/m² from R_1 and R_v, so that the drag dissipates")
    given = {"m": "kg", "l_f": "m", "l_r": "m", "T_s": "s", "d": "rad/s", "v_0": "m/s", "front_share": "-"}
    given |= {"u_0": "-"} if car.sets_force else {}
    lines += [f"  {s:11} = {values[s]:<10.4g}        {unit:7} held" for s, unit in given.items() if s not in fitted]
    lines += [
        f"  {a} and {b} go together (correlation {rho:+.2f}): one is known as far as the other is"
        for a, b, rho in facts.get("correlated", ())
    ]
    lines.append("  m, I_z and all forces scale together: m is held")
    if not facts.get("mass_given", True):
        lines.append("  the mass is not given: m = 1 kg, forces read as accelerations")
    if "optimiser" in facts and fitted:
        lines.append(f"  {facts['optimiser']}; {facts['reached']}")
    return lines

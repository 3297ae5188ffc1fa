"""The Newton-Euler constants that a fit chooses: their ranges, the car they make, and how they are described."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.models.limits import LIMITS
from bcid.models.newton_euler.saved_car import correlation_fact
from bcid.physics.car import Car
from bcid.vehicle import Vehicle

GRAVITY = 9.81  # m/s^2

BIASED_TWISTS = "± leave out that smoothed velocities bias the fit: for constants use --loss poses"
"""What must be known of the errors of constants that were fitted to smoothed velocities, by one of twists' losses."""
TOP_SPEED_QUANTILE = 0.999  # of the speeds driven
# Constants at which a force is cut off: predictions of a take that never reaches one do not depend on it.
SATURATIONS = ("F_m_max", "F_f_max", "F_r_max")
UNITS = {
    "m": "kg", "I_z": "kg m²", "l_f": "m", "l_r": "m", "T_s": "s", "d": "rad/s", "F_m_max": "N", "K_t": "N s/m",
    "K_b": "N s/m", "C_f": "N/rad", "C_r": "N/rad", "F_f_max": "N", "F_r_max": "N", "R_1": "N s/m", "R_2": "N s²/m²",
    "v_0": "m/s",
}  # fmt: skip
FOLLOWING_UNITS = {k: v for k, v in UNITS.items() if k not in ("F_m_max", "K_b")}
FORCE_UNITS = {k: v for k, v in UNITS.items() if k != "F_m_max"} | {"K_t": "N", "u_0": "-", "K_v": "N s/m"}


def constant_units(car: Car) -> dict[str, str]:
    """Units of a car's constants by symbol, in the order in print; they differ by what the throttle is."""
    if car.follows_wheel:
        return FOLLOWING_UNITS
    return FORCE_UNITS if car.sets_force else UNITS


class FittedConstant(NamedTuple):
    """One constant to be fitted, searched between `low` and `high` on a logarithmic scale."""

    symbol: str
    unit: str
    low: float
    high: float
    meaning: str


def drag_per_speed(car: Car, speed_mps: float) -> float:
    """Drag force over speed at `speed_mps`, R_v = R_1 + R_2 v (N s/m)."""
    return car.R_1 + car.R_2 * speed_mps


def values_of_constants(car: Car, facts: Mapping[str, Any]) -> dict[str, float]:
    """The car's constants by symbol, with R_v at the top speed that the `facts` of its fit state."""
    return car._asdict() | {"R_v": drag_per_speed(car, float(facts.get("top_speed_mps", 0.0)))}


def constants_to_fit(vehicle: Vehicle, top_speed_mps: float) -> tuple[FittedConstant, ...]:
    """The constants that a fit to recordings chooses, with search ranges (SI) scaled by the car's mass and lengths.

    Drag is searched as R_1 and R_v = R_1 + R_2 v at the top speed, both positive, so that it dissipates energy
    (docs/errata.md row 6).
    """
    m = vehicle.mass_kg
    arm = vehicle.body.cog_to_front_m * vehicle.body.cog_to_rear_m
    speed = (
        FittedConstant("F_m_max", "N", 0.05 * m, 1.0 * m * GRAVITY, "maximum motor force"),
        FittedConstant("K_t", "N s/m", 0.05 * m, 30.0 * m, "throttle gain"),
    )
    force = (
        FittedConstant("K_t", "N", 0.1 * m, 50.0 * m, "throttle gain"),
        FittedConstant("u_0", "-", 1e-3, 0.5, "throttle dead zone"),
        FittedConstant("K_v", "N s/m", 1e-3 * m, 10.0 * m, "loss of motor force with speed"),
    )
    brake = FittedConstant("K_b", "N s/m", 0.01 * m, 20.0 * m, "brake gain")
    # within 0.02 to 0.1 s: a stiffer car would want finer steps than models of a period make
    following = FittedConstant("K_t", "N s/m", 10.0 * m, 50.0 * m, "force by slip of the driven wheel")
    return (
        *{"speed": (*speed, brake), "force": (*force, brake), "measured-speed": (following,)}[vehicle.motor.law],
        FittedConstant("I_z", "kg m²", 0.2 * m * arm, 6.0 * m * arm, "moment of inertia"),
        FittedConstant("C_f", "N/rad", 0.5 * m, 200.0 * m, "front cornering stiffness"),
        FittedConstant("C_r", "N/rad", 0.5 * m, 200.0 * m, "rear cornering stiffness"),
        FittedConstant("F_f_max", "N", 0.02 * m * GRAVITY, 1.0 * m * GRAVITY, "maximum front side force"),
        FittedConstant("F_r_max", "N", 0.02 * m * GRAVITY, 1.0 * m * GRAVITY, "maximum rear side force"),
        FittedConstant("R_1", "N s/m", 1e-3 * m, 5.0 * m, "linear drag"),
        FittedConstant("R_v", "N s/m", 1e-3 * m, 5.0 * m, f"drag per speed at {top_speed_mps:.2f} m/s"),
    )


@dataclass(frozen=True)
class ConstantBox:
    """The ranges of the fitted constants as the unit box: a point x in it is a car."""

    vehicle: Vehicle
    T_s: float
    d: float
    v_0: float
    top_speed: float  # m/s, the fastest driven

    @cached_property
    def constants(self) -> tuple[FittedConstant, ...]:
        """The fitted constants, one for each coordinate."""
        return constants_to_fit(self.vehicle, self.top_speed)

    @cached_property
    def log_range(self) -> Floats:
        """Growth of each constant's logarithm across the box, ln(high / low)."""
        return np.log([p.high / p.low for p in self.constants])

    def car(self, x: Floats) -> Car:
        """The car at the point `x` (n,) of the box, with the vehicle file's constants."""
        vehicle, body = self.vehicle, self.vehicle.body
        values = [p.low * np.exp(g * r) for p, g, r in zip(self.constants, x, self.log_range, strict=True)]
        fitted = {p.symbol: float(v) for p, v in zip(self.constants, values, strict=True)}
        R_v = fitted.pop("R_v")
        # laws without a limit of their own; a measured speed holds what the brake does, too
        fitted = {"F_m_max": 1e3 * vehicle.mass_kg * GRAVITY, "K_b": 0.0} | fitted
        law = vehicle.motor.law
        return Car(
            m=vehicle.mass_kg, l_f=body.cog_to_front_m, l_r=body.cog_to_rear_m, T_s=self.T_s, d=self.d, v_0=self.v_0,
            R_2=(R_v - fitted["R_1"]) / self.top_speed, front_share=vehicle.front_share,
            sets_force=float(law == "force"), reverses=float(vehicle.motor.reverses),
            follows_wheel=float(law == "measured-speed"), **fitted,
        )  # fmt: skip


def constant_facts(
    constants: Mapping[str, Mapping[str, Any]], covariance: Floats, relative_se: Floats, at_bound: list[str]
) -> dict[str, Any]:
    """What a saved model states of n fitted constants: `fitted`, `correlation`, `correlated` and `at_bound`.

    `constants` gives each symbol's unit and meaning; `relative_se` (n,) are standard errors over values, NaN where
    not identified.  `covariance` (n, n) of the errors, in any units, gives all correlations and, for people, the pairs
    beyond LIMITS.min_correlation.
    """
    sd, symbols = np.sqrt(np.diag(covariance)), list(constants)
    rho = covariance / np.outer(sd, sd)
    return {
        "fitted": {
            symbol: {**about, "relative_se": float(se) if np.isfinite(se) else None}
            for (symbol, about), se in zip(constants.items(), relative_se, strict=True)
        },
        "correlation": correlation_fact(symbols, covariance),
        "correlated": [
            (symbols[i], symbols[j], float(rho[i, j]))
            for i, j in itertools.combinations(range(len(symbols)), 2)
            if abs(rho[i, j]) > LIMITS.min_correlation
        ],
        "at_bound": at_bound,
    }


def errors_lack_bias(facts: Mapping[str, Any]) -> bool:
    """Whether the `facts` of a fit state errors of constants that leave out a bias, as all but those of poses do."""
    return bool(facts.get("fitted")) and facts.get("loss") != "poses"


def is_identified(symbol: str, facts: Mapping[str, Any]) -> bool:
    """Whether the recordings identify the fitted constant `symbol`, by the `facts` of the fit.

    Its standard error is at most LIMITS.max_relative_se (half) of its value, and it is not at a bound of its range.
    """
    error = facts["fitted"][symbol]["relative_se"]
    return error is not None and error <= LIMITS.max_relative_se and symbol not in facts.get("at_bound", ())


def stated_errors(car: Car, facts: Mapping[str, Any]) -> dict[str, float | None]:
    """Standard errors of the fitted constants by symbol, in their units, by the `facts` of a fit or of a diagnosis.

    None where the recordings do not identify a constant.  Of a diagnosis any error of drag, which may be zero, counts.
    """
    values = values_of_constants(car, facts)
    errors = {
        symbol: about["relative_se"] * abs(values[symbol]) if is_identified(symbol, facts) else None
        for symbol, about in facts.get("fitted", {}).items()
    }
    for symbol, error in facts.get("se", {}).items():
        if symbol in values:
            usable = error is not None and np.isfinite(error) and error > 0.0
            known = usable and (symbol in ("R_1", "R_2") or error <= LIMITS.max_relative_se * abs(values[symbol]))
            errors[symbol] = error if known else None
    return errors


def constant_lines(car: Car, facts: Mapping[str, Any]) -> list[str]:
    """The table of a car's constants in print, one a line: value, standard error, unit, meaning, and * where fitted.

    `facts` of the fit holds the errors; lines below the table name correlated pairs, a mass that is not given, and
    the optimiser.
    """
    fitted, values = facts.get("fitted", {}), values_of_constants(car, facts)
    lines = list[str]()
    for symbol, about in fitted.items():
        if is_identified(symbol, facts):
            value, meaning = f"= {values[symbol]:<10.4g} ±{100 * about['relative_se']:<5.2g}%", about["meaning"]
        else:
            why = "at its bound" if symbol in facts.get("at_bound", ()) else "not excited by the takes"
            value, meaning = "not identified      ", f"{about['meaning']} ({why})"
        lines.append(f"  {symbol:10}* {value} {about['unit']:7} {meaning}")
    lines.append(f"  {'R_2':11} = {car.R_2:<10.4g}        N s²/m² from R_1 and R_v, so that the drag dissipates")
    units = constant_units(car) | {"front_share": "-"}
    fixed = ["m", "l_f", "l_r", "T_s", "d", "v_0", "front_share", *(["u_0"] if car.sets_force else [])]
    lines += [f"  {s:11} = {values[s]:<10.4g}        {units[s]:7} fixed" for s in fixed if s not in fitted]
    lines += [
        f"  {a} and {b} are correlated ({rho:+.2f}): one is known only as well as the other"
        for a, b, rho in facts.get("correlated", ())
    ]
    lines.append("  m, I_z and all forces scale together: m is fixed")
    if not facts.get("mass_given", True):
        lines.append("  the mass is not given: m = 1 kg, forces read as accelerations")
    if "optimiser" in facts and fitted:
        lines.append("  " + "; ".join(facts[key] for key in ("optimiser", "fit_quality") if key in facts))
    return lines

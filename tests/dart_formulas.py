"""The car of pipelines/dart/simulation.toml, as compiled, beside the formulas of the DART's authors.

`python tests/dart_formulas.py` writes docs/results/dart_formulas.json: for each force the full scale of the authors'
values where the drives are, and how far ours are from them, in percents of it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import dart_authors as authors
import numpy as np
from dart_authors import Floats, Turns

from bcid.diagnosis.reference import ParameterFile, read_parameter_file
from bcid.effects.car import Actuation, BodyState, LagState, wrench_with_effects
from bcid.effects.constants import Constants
from bcid.effects.lags import first_order_lag
from bcid.effects.remainder import no_remainder
from bcid.effects.table import effect_switches
from bcid.models import published
from bcid.physics.car import Car
from bcid.vehicle import Body, read_vehicle

ROOT = Path(__file__).parents[1]
DART = ROOT / "pipelines" / "dart"
PUBLISHED, VEHICLE = DART / "simulation.toml", DART / "vehicle.toml"
RESULT = ROOT / "docs" / "results" / "dart_formulas.json"

# what the drives go through
SPEEDS = np.linspace(0.3, 2.0, 35)  # m/s
ANGLES = np.linspace(0.05, 0.385, 8)  # rad, to either side
THROTTLES = np.linspace(0.0, 0.6, 61)  # 0.58 holds 2 m/s in the tightest turn
SLIPS = np.linspace(-0.4, 0.4, 81)  # rad
CLOSED_MPS = 0.4  # from which the authors' switch at 0.3 m/s is closed to within 2 %
BOTH_SIDES = np.r_[-ANGLES[::-1], ANGLES]
STEERING = ("steering_friction", "steering_drag")


class PublishedCar(NamedTuple):
    """The car that a simulation file describes."""

    car: Car
    effects: dict[str, float]  # SI, by their field among the switches

    def wrenches(self, states: Turns, *without: str) -> Floats:
        """Force along and across the car (N) and moment (N m), (3, n), as compiled, `without` some effects.

        The motor's force is the one at which its lag settles.
        """
        off = ("motor_lag", *without)
        e = effect_switches({field: v for field, v in self.effects.items() if field.partition("__")[0] not in off})
        found = [
            wrench_with_effects(
                BodyState(0.0, 0.0, 0.0, v_x, v_y, omega),
                Actuation(0.0, 1.0, delta, 0.0, throttle, throttle, 0.0, 0.0, no_remainder(0.0)),
                LagState(0.0, 0.0, 0.0), self.car, e, Constants(),
            )[:3]
            for v_x, v_y, omega, delta, throttle in zip(*states, strict=True)
        ]  # fmt: skip
        return np.array(found).T

    def motor_forces(self, throttle: Floats, v: Floats) -> Floats:
        """Forces (n,) of the motor in N, settled, under a throttle at the speeds v (m/s) straight ahead."""
        return np.asarray(self.wrenches(straight(v, throttle))[0] - self.wrenches(straight(v, 0.0 * v))[0])

    def side_forces(self, along: Floats, across: Floats) -> Floats:
        """Side forces (2, n) in N of the axles, if all contact points move at `along` and `across` (m/s)."""
        zero = np.zeros_like(along)
        _, F_y, M_z = self.wrenches(Turns(along, across, zero, zero, zero))
        l_f, l_r = self.car.l_f, self.car.l_r
        return np.array([l_r * F_y + M_z, l_f * F_y - M_z]) / (l_f + l_r)


def published_car(file: ParameterFile, body: Body) -> PublishedCar:
    """The car with the parameters and effects of a simulation `file` and the mass and lengths of `body`."""
    geometry = {
        "m": body.mass_kg, "l_f": body.cog_to_front_m, "l_r": body.cog_to_rear_m,
        "front_share": body.front_drive_share, "sets_force": 1.0, "u_0": 0.0, "F_m_max": 1e4,
    }  # fmt: skip
    effects = {f"{name}__{s}": v for name, values in file.effects.items() for s, v in values.items()}
    return PublishedCar(published.newton_euler().car._replace(**geometry | file.parameters), effects)


def straight(v: Floats, throttle: Floats) -> Turns:
    """The car straight ahead at the speeds v (m/s) under a throttle."""
    zero = np.zeros_like(v)
    return Turns(v, zero, zero, zero, throttle)


def grid(angles: Floats, speeds: Floats) -> tuple[Floats, Floats]:
    """All pairs of an angle (rad) and a speed (m/s)."""
    delta, v = np.meshgrid(angles, speeds)
    return delta.ravel(), v.ravel()


def compare(force: str, where: str, unit: str, ours: Floats, theirs: Floats, full_scale: float = 0.0) -> dict[str, Any]:
    """A row of the table: differences as percents of the largest of the authors' values, or of the `full_scale`."""
    scale, off = full_scale or float(np.abs(theirs).max()), np.abs(ours - theirs)
    percents = 100.0 / scale * np.array([np.sqrt(np.mean(off**2)), off.max()])
    return {
        "force": force, "where": where, "unit": unit, "full_scale": round(scale, 4),
        "rms_percent": round(float(percents[0]), 2), "largest_percent": round(float(percents[1]), 2),
    }  # fmt: skip


def motor_rows(car: PublishedCar) -> list[dict[str, Any]]:
    """The motor's force by throttle and speed, and on its way after a throttle that jumps.

    The authors' lag is the throttle's, ours the force's: of a throttle from 0 theirs begins to push later.
    """
    throttle, v = grid(THROTTLES, SPEEDS)
    theirs = authors.motor_force(throttle, v)
    rows = [compare("motor", "throttle 0 to 0.6, 0.3 to 2 m/s", "N", car.motor_forces(throttle, v), theirs)]
    t, tau = np.linspace(0.0, 0.5, 101), car.effects["motor_lag__tau"]
    for before, after in ((0.2, 0.3), (0.0, 0.3)):
        first, last = car.motor_forces(np.array([before, after]), np.ones(2))
        ours = np.array([first_order_lag(first, last, last, h / tau) for h in t])
        lagging = after + (before - after) * np.exp(-t / authors.THROTTLE_LAG_S)
        where = f"0.5 s after a throttle from {before:g} to {after:g}, 1 m/s"
        rows.append(compare("motor", where, "N", ours, authors.motor_force(lagging, np.ones_like(t))))
    return rows


def resistance_rows(car: PublishedCar) -> list[dict[str, Any]]:
    """What holds the car straight ahead, and what an angle of the wheel adds, along it, at the speed of its rolling."""
    ahead = authors.rolling_resistance(SPEEDS) + authors.steering_resistance(0.0 * SPEEDS, SPEEDS)
    ours = -car.wrenches(straight(SPEEDS, 0.0 * SPEEDS))[0]
    rows = [compare("resistance straight ahead", "0.3 to 2 m/s", "N", ours, ahead)]
    delta, v = grid(BOTH_SIDES, SPEEDS)
    rolling = Turns(v * np.cos(delta), v * np.sin(delta), 0.0 * v, delta, 0.0 * v)
    F_x, F_y, _ = car.wrenches(rolling, *STEERING) - car.wrenches(rolling)
    added = np.cos(delta) * F_x + np.sin(delta) * F_y
    theirs = authors.steering_resistance(delta, v) - authors.steering_resistance(0.0 * v, v)
    closed, before = v > CLOSED_MPS - 1e-9, 2.2 * np.abs(delta) * v
    name, angles = "resistance by the wheel's angle", "0.05 to 0.385 rad"
    return [
        *rows,
        compare(name, f"{angles}, 0.4 to 2 m/s", "N", added[closed], theirs[closed]),
        compare(name, f"{angles}, 0.3 to 2 m/s", "N", added, theirs),
        compare("2.2 |angle| v in its place", f"{angles}, 0.4 to 2 m/s", "N", before[closed], theirs[closed]),
    ]


def tyre_rows(car: PublishedCar, turns: Turns) -> list[dict[str, Any]]:
    """Side forces by the slip angle, and at the contact points' velocities in steady turns."""
    v_fx, v_fy, v_ry = authors.contact_velocities(*turns[:4])
    fast = np.full_like(SLIPS, 2.0)
    moves = {
        "slip angles to 0.4 rad, 2 m/s": ((fast, fast * np.tan(SLIPS)),) * 2,
        "steady turns": ((v_fx, v_fy), (turns.v_x, v_ry)),
    }
    laws = (authors.front_side_force, authors.rear_side_force)
    return [
        compare(f"{name} side force", where, "N", car.side_forces(*move)[axle], law(authors.slip_angle(*move)))
        for where, axles in moves.items()
        for axle, (name, law, move) in enumerate(zip(("front", "rear"), laws, axles, strict=True))
    ]


def wrench_rows(car: PublishedCar, turns: Turns) -> list[dict[str, Any]]:
    """All forces together in steady turns: which axle has what share, and whose speed counts, differs besides.

    Along the car they nearly balance, and the moments do: full scale is the motor's force, and the front axle's moment.
    """
    ours, theirs = car.wrenches(turns), authors.wrench(*turns)
    side = authors.front_side_force(authors.slip_angle(*authors.contact_velocities(*turns[:4])[:2]))
    push = authors.motor_force(turns.throttle, turns.v_x).max()
    kinds = (("force along the car", "N", push), ("force across the car", "N", 0.0),
             ("moment", "N m", authors.L_F * np.abs(side).max()))  # fmt: skip
    return [
        compare(name, "steady turns", unit, mine, other, float(scale))
        for (name, unit, scale), mine, other in zip(kinds, ours, theirs, strict=True)
    ]


def formula_table() -> list[dict[str, Any]]:
    """How far the car of simulation.toml is from the authors' formulas, force by force.

    Steady turns are those of the authors' car at 0.4 to 2 m/s and 0.05 to 0.385 rad.  The wheel's angle is no part of
    the simulation: vehicle.toml has a table of it that was measured on other drives.
    """
    vehicle = read_vehicle(VEHICLE)
    car = published_car(read_parameter_file(PUBLISHED), vehicle.body)
    delta, v = grid(BOTH_SIDES, SPEEDS[2::2])
    turns = authors.steady_turns(v, delta)
    command = np.linspace(-1.0, 1.0, 81)
    mapped = vehicle.columns.steering_rad if vehicle.columns else None
    assert mapped
    ours = np.interp(command, *np.array(mapped.points).T)
    angle = compare("wheel angle in vehicle.toml", "commands -1 to 1", "rad", ours, authors.wheel_angle(command))
    return [*motor_rows(car), *resistance_rows(car), *tyre_rows(car, turns), *wrench_rows(car, turns), angle]


if __name__ == "__main__":
    RESULT.write_text(json.dumps(formula_table(), indent=1) + "\n", encoding="utf-8")

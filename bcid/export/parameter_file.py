"""A car's constants under the names of other simulators: CommonRoad's single-track model and the F1TENTH gym's.

Both compute the side force of an axle as mu C_S F_z alpha: C_S (1/rad) is a cornering stiffness per load for a friction
coefficient mu of 1, F_z the load of the standing car, alpha the slip angle by small angles (Althoff and Würsching,
CommonRoad: Vehicle Models, single-track model).  The gym has a C_S for each axle, CommonRoad one for both.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from bcid.effects.table import ENTRIES
from bcid.errors import UsageError
from bcid.evaluation.validity import QUANTITIES
from bcid.export.exported import Exported
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.parameters import constant_units, stated_errors
from bcid.physics.car import Car

GRAVITY = 9.81
"""m/s^2, with which those simulators turn a friction coefficient into a force."""

FLAGS = {
    "front_share": "share of motor and drag at the front axle: 1 front drive, 0 rear drive",
    "sets_force": "1: the throttle sets a force, as a share of full throttle",
    "follows_wheel": "1: the throttle is the driven wheel's measured speed, m/s; where both are 0, a reference speed",
    "reverses": "1: a throttle below 0 drives backward, 0: it is a share of the brake",
}
"""What the car's numbers that choose between laws mean."""

_HEAD = """\
# {about}
#
# The fitted constants in SI units, and what they are for two simulators that have other tyres, motors and actuators.
# Those have the states [x, y, delta, v, yaw, yaw_rate, beta] of the centre of gravity, and the commands [steering rate,
# acceleration].  There v_x = v cos(beta) and v_y = v sin(beta), so that v has the sign of v_x, and beta is
# atan(v_y / v_x).
#
# What they lack:
#   - Their tyres have no saturation: side forces grow with the slip angle without an end, ours to F_f_max and F_r_max.
#   - They have no motor, drag, brake or servo: their commands are what ours come to.  No load is transferred (h = 0).
#   - {effects}
# So they turn as this car does as long as its tyres hold, and brake, coast and slide as they do themselves.
"""

_COMMONROAD = """\
# For CommonRoad (vehicle models, VehicleParameters), in the nesting of its files.  Its single-track model knows one
# cornering stiffness per load, -p_ky1, for both axles.  Here it is that of both together: sliding sideways makes the
# same side force as in this car, but the car steers neutrally at any speed, whatever this one does, which C_Sf and C_Sr
# above show.
"""


class Row(NamedTuple):
    """One constant in the file; `value` is None where the model does not know it, and it is left out."""

    name: str
    value: float | None
    meaning: str  # or its unit, and how well it is known


def write_parameter_file(e: Exported) -> str:
    """The text of NAME_parameters.yaml: the constants as they were fitted, and as others call them.

    It has the sections `newton_euler`, `f1tenth_gym` (flat, the gym's `params`) and `commonroad` (nested).

    Raises:
        UsageError: the model has no such constants.
    """
    car = getattr(e.model, "car", None)
    if not isinstance(car, Car):
        raise UsageError(f"{e.model.name} has no constants of a car\n  next: export newton-euler, or a diagnosis")
    errors = stated_errors(car, getattr(e.model, "facts", {}))
    gym = gym_constants(car, e, errors)
    fitted = [
        Row(symbol, getattr(car, symbol), f"{unit}{_tell_error(symbol, errors)}")
        for symbol, unit in constant_units(car).items()
    ]
    blocks = [
        _HEAD.format(about=e.about, effects=_tell_effects(e)),
        "newton_euler:\n" + _lines([*fitted, *(Row(flag, getattr(car, flag), says) for flag, says in FLAGS.items())]),
        "# For the F1TENTH gym: `params` as it calls them.\nf1tenth_gym:\n" + _lines(gym),
        _COMMONROAD + "commonroad:\n" + _commonroad_lines(car, {row.name: row for row in gym}),
    ]
    return "\n".join(blocks)


def gym_constants(car: Car, e: Exported, errors: Mapping[str, float | None]) -> list[Row]:
    """The constants of the F1TENTH gym's single-track model for `car`, in its order; `errors` are as stated."""
    wheelbase = car.l_f + car.l_r
    load_f, load_r = (car.m * GRAVITY * lever / wheelbase for lever in (car.l_r, car.l_f))
    mu = (car.F_f_max + car.F_r_max) / (car.m * GRAVITY)
    guessed = [symbol for symbol in ("F_f_max", "F_r_max") if symbol in errors and errors[symbol] is None]
    doubt = f"; a guess, as {' and '.join(guessed)} is not identified: mu C_S alone counts" if guessed else ""
    return [
        Row("mu", mu, f"largest side forces of both axles over the weight; it only scales C_Sf and C_Sr{doubt}"),
        Row("C_Sf", car.C_f / (mu * load_f), "1/rad"), Row("C_Sr", car.C_r / (mu * load_r), "1/rad"),
        Row("lf", car.l_f, "m"), Row("lr", car.l_r, "m"),
        Row("h", 0.0, "m, height of the centre of gravity: no load is transferred"),
        Row("m", car.m, "kg"), Row("I", car.I_z, "kg m^2"), *_steering_limits(car, e), *_speed_limits(car, e),
        Row("width", None, "m"), Row("length", None, "m"),
    ]  # fmt: skip


def _tell_error(symbol: str, errors: Mapping[str, float | None]) -> str:
    """How well a constant is known, by the standard `errors` of those that were fitted."""
    if symbol == "R_2" and "R_v" in errors:
        return ", from R_1 and the drag at the fastest"
    if symbol not in errors:
        return ""
    error = errors[symbol]
    return ", not identified by the recordings" if error is None else f", standard error {error:.2g}"


def largest_acceleration(car: Car) -> float | None:
    """The largest acceleration (m/s^2) that the motor of `car` makes, by its law; None where that has no limit.

    A speed controller ends at F_m_max; full throttle that sets a force makes K_t (1 - u_0) of the car at rest; a wheel
    whose speed was measured pulls as hard as it was made to.
    """
    if car.follows_wheel:
        return None
    force = min(car.K_t * (1.0 - car.u_0), car.F_m_max) if car.sets_force else car.F_m_max
    return force / car.m


def _steering_limits(car: Car, e: Exported) -> list[Row]:
    """Limits of the steering angle, the wheel's where the model knows it or else those of the data, and of its rate."""
    (low, high), whose = _range_of_data(e, "u_s"), "the farthest command in the data; the wheel may turn farther"
    if isinstance(e.model, AugmentedNewtonEuler):
        low, high, whose = -e.model.angle_limit, e.model.angle_limit, "the wheel's limit"
    return [
        Row("s_min", low, f"rad, {whose}"), Row("s_max", high, f"rad, {whose}"),
        Row("sv_min", -car.d, "rad/s"), Row("sv_max", car.d, "rad/s"),
    ]  # fmt: skip


def _speed_limits(car: Car, e: Exported) -> list[Row]:
    """Limits of acceleration and speed; the largest speed is that of the data, in either direction."""
    slowest, fastest = _range_of_data(e, "v_x")
    backward = bool(car.reverses or car.follows_wheel)
    v_max = None if slowest is None or fastest is None else max(fastest, -slowest if backward else fastest)
    v_min = (None if v_max is None else -v_max) if backward else 0.0
    forward_only = "m/s: it does not reverse; the gym's own speed control divides by it"
    return [
        Row("v_switch", v_max, "m/s, beyond which a_max falls there; here at no speed"),
        Row("a_max", largest_acceleration(car), "m/s^2, of the motor at rest"),
        Row("v_min", v_min, "m/s, taken as -v_max" if backward else forward_only),
        Row("v_max", v_max, "m/s, the fastest in the data"),
    ]  # fmt: skip


def _range_of_data(e: Exported, quantity: str) -> tuple[float | None, float | None]:
    """The lowest and highest value of one of QUANTITIES in the data of the fit; None where that is not known."""
    if e.validity is None:
        return None, None
    place = list(QUANTITIES).index(quantity)
    return e.validity.range.low[place], e.validity.range.high[place]


def _commonroad_lines(car: Car, gym: dict[str, Row]) -> str:
    """The lines of the section for CommonRoad, whose limits are those of the rows for the gym by name."""
    mu = gym["mu"].value
    stiffness = (car.C_f + car.C_r) / (car.m * GRAVITY)
    groups = {
        "tire": [
            Row("p_dy1", mu, "friction coefficient, mu"),
            Row("p_ky1", -stiffness, "1/rad; C_Sf = C_Sr = -p_ky1 / p_dy1"),
        ],
        "steering": [gym[key]._replace(name=name) for key, name in _STEERING.items()],
        "longitudinal": [gym[key] for key in ("v_min", "v_max", "v_switch", "a_max")],
    }
    own = [
        Row("a", car.l_f, "m, from the centre of gravity to the front axle"), Row("b", car.l_r, "m, to the rear axle"),
        Row("h_s", 0.0, "m, height of the centre of gravity: no load is transferred"), Row("m", car.m, "kg"),
        Row("I_z", car.I_z, "kg m^2"), Row("l", None, "m, length of the body"), Row("w", None, "m, its width"),
    ]  # fmt: skip
    return _lines(own) + "".join(f"  {group}:\n{_lines(rows, '    ')}" for group, rows in groups.items())


_STEERING = {"s_min": "min", "s_max": "max", "sv_min": "v_min", "sv_max": "v_max"}
"""CommonRoad's names of the gym's limits of the steering."""


def _tell_effects(e: Exported) -> str:
    """Which effects of the model neither simulator has."""
    on = getattr(e.model, "effects", {})
    left_out = [effect.id for effect in ENTRIES.values() if any(field in on for field in effect.fields)]
    return f"Effects left out: {', '.join(left_out)}." if left_out else "The model has no effects that are left out."


def _lines(rows: list[Row], indent: str = "  ") -> str:
    """The lines of a section: what is known, each with its meaning, then a remark on what is not."""
    known = [f"{indent}{row.name}: {_number(row.value)}{row.meaning and f'  # {row.meaning}'}\n" for row in rows
             if row.value is not None]  # fmt: skip
    unknown = [row.name for row in rows if row.value is None]
    return "".join(known) + (f"{indent}# not known to the model: {', '.join(unknown)}\n" if unknown else "")


def _number(value: float) -> str:
    """A number in YAML, of which a reader takes one without a point, like 1e-05, for a word."""
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")

"""A car's constants under the names of other simulators: CommonRoad's single-track model and the F1TENTH gym's."""

from __future__ import annotations

from typing import Any

from bcid.errors import UsageError
from bcid.export.exported import Exported
from bcid.models.newton_euler.parameters import constant_units
from bcid.physics.car import Car

GRAVITY = 9.81
"""m/s^2, with which those simulators turn a friction coefficient into a force."""

_HEAD = """\
# {about}
#
# States there are [x, y, delta, v, yaw, yaw_rate, beta], commands [steering rate, acceleration a_x]; from ours:
#   v = sqrt(v_x^2 + v_y^2), beta = atan2(v_y, v_x);   v_x = v cos(beta), v_y = v sin(beta).
# Their tyres: F_y = -mu C_S F_z alpha with F_z of the axle standing still and C_S for a friction coefficient of 1, so
# that the cornering stiffness is C_f = mu C_Sf m g l_r / (l_f + l_r).  They know neither our motor nor our actuator, so
# that only handling is the same: a_max is the largest motor force over the mass.
"""


def write_parameter_file(e: Exported) -> str:
    """The text of NAME_parameters.yaml, with the constants in SI as they were fitted, and as others call them.

    Raises:
        UsageError: the model has no such constants.
    """
    car = getattr(e.model, "car", None)
    if not isinstance(car, Car):
        raise UsageError(f"{e.model.name} has no constants of a car\n  next: export newton-euler, or a diagnosis")
    constants = {symbol: (getattr(car, symbol), unit) for symbol, unit in constant_units(car).items()}
    lines = [_HEAD.format(about=e.about), "newton_euler:"]
    lines += [f"  {symbol}: {value!r}{f'  # {unit}' if unit else ''}" for symbol, (value, unit) in constants.items()]
    lines += ["", "single_track:"]
    lines += [f"  {key}: {value!r}  # {what}" for key, value, what in single_track_constants(car, e)]
    return "\n".join(lines) + "\n"


def single_track_constants(car: Car, e: Exported) -> list[tuple[str, float, str]]:
    """Name, value and meaning of each constant of the single-track model that `car` has; the body's size is unknown."""
    wheelbase = car.l_f + car.l_r
    load_f, load_r = (car.m * GRAVITY * lever / wheelbase for lever in (car.l_r, car.l_f))
    mu = (car.F_f_max + car.F_r_max) / (car.m * GRAVITY)
    rows = [
        ("mu", mu, "largest side forces of both axles over the weight"),
        ("C_Sf", car.C_f / (mu * load_f), "1/rad"),
        ("C_Sr", car.C_r / (mu * load_r), "1/rad"),
        ("lf", car.l_f, "m"),
        ("lr", car.l_r, "m"),
        ("h", 0.0, "m, height of the CoG: no load is transferred"),
        ("m", car.m, "kg"),
        ("I", car.I_z, "kg m^2"),
        ("sv_min", -car.d, "rad/s"),
        ("sv_max", car.d, "rad/s"),
        ("a_max", car.F_m_max / car.m, "m/s^2"),
    ]
    return rows + _limits_of_data(e)


def _limits_of_data(e: Exported) -> list[tuple[str, float, str]]:
    """Limits of steering angle and speed, as far as the data goes that the model was fitted on."""
    if e.validity is None:
        return []
    limits: Any = e.validity.range
    (v_low, *_, s_low, _), (v_high, *_, s_high, _) = limits
    seen = "of the data that the model was fitted on"
    return [
        ("s_min", s_low, f"rad, {seen}"), ("s_max", s_high, f"rad, {seen}"), ("v_min", v_low, f"m/s, {seen}"),
        ("v_max", v_high, f"m/s, {seen}"), ("v_switch", v_high, "m/s, from which a_max falls there: it is not reached"),
    ]  # fmt: skip

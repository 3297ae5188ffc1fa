"""The DART's dynamic bicycle as its authors publish it, written down anew from their formulas and figures.

Source: `dart_dynamic_models.py` of Lorenzo-Lyons/DART.  SI; x points forward, y and angles to the left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import root

Floats = npt.NDArray[np.float64]

MASS, FRONT_LOAD, REAR_LOAD = 1.580, 0.847, 0.733  # kg
WHEELBASE = 0.1735  # m
L_R = WHEELBASE * FRONT_LOAD / MASS
L_F = WHEELBASE - L_R
GRAVITY = 9.81  # m/s^2
THROTTLE_ZERO, THROTTLE_LAG_S = 0.16378, 0.08433


def motor_force(throttle: Floats, v: Floats) -> Floats:
    """Force (N) of the motor at a throttle from 0 to 1 and the speed v (m/s)."""
    opened = throttle - THROTTLE_ZERO
    return (25.3585 - 4.8153 * v) * 0.5 * (1.0 + np.tanh(100.0 * opened)) * opened


def rolling_resistance(v: Floats) -> Floats:
    """Resistance (N) at the speed v >= 0 (m/s)."""
    return 1.26599 * np.tanh(7.66637 * v) + 0.73930 * v - 0.11232 * v**2


def steering_resistance(delta: Floats, v: Floats) -> Floats:
    """Resistance (N) of a wheel at the angle delta (rad) and the speed v (m/s).

    It is switched off below 0.3 m/s, and negative near delta = 0.
    """
    by_angle = -0.11826 + 5.91586 * delta * np.tanh(30.0 * delta)
    return 0.5 * (1.0 + np.tanh(20.0 * (v - 0.3))) * (0.77931 + 0.22619 * (v - 0.5)) * by_angle


def slip_angle(along: Floats, across: Floats) -> Floats:
    """Slip angle (rad) of a wheel whose contact point moves at `along` and `across` (m/s)."""
    return np.arctan2(across, along + np.exp(-3.0 * along**2))


def front_side_force(alpha: Floats) -> Floats:
    """Side force (N) of the front tyres at the slip angle alpha (rad)."""
    return -0.84069 * FRONT_LOAD * GRAVITY * np.sin(0.84074 * np.arctan(8.59804 * alpha))


def rear_side_force(alpha: Floats) -> Floats:
    """Side force (N) of the rear tyres at the slip angle alpha (rad)."""
    return -0.85467 * REAR_LOAD * GRAVITY * np.sin(0.95911 * np.arctan(11.54928 * alpha))


def wheel_angle(command: Floats) -> Floats:
    """Angle (rad) at which the wheel stands under a steering command from -1 (right) to 1 (left)."""
    s = command - 0.0270
    left = 0.5 * (1.0 + np.tanh(30.0 * s))
    return left * 0.36576 * np.tanh(1.39293 * s) + (1.0 - left) * 0.51479 * np.tanh(1.02304 * s)


def contact_velocities(v_x: Floats, v_y: Floats, omega: Floats, delta: Floats) -> tuple[Floats, Floats, Floats]:
    """Velocity (m/s) of the front contact point along and across its wheel, and of the rear one across the car."""
    across, sin, cos = v_y + L_F * omega, np.sin(delta), np.cos(delta)
    return cos * v_x + sin * across, cos * across - sin * v_x, v_y - L_R * omega


def wrench(v_x: Floats, v_y: Floats, omega: Floats, delta: Floats, throttle: Floats) -> Floats:
    """Force along and across the car (N) and moment (N m) on it; what acts along is shared by the axles' loads."""
    along = motor_force(throttle, v_x) - rolling_resistance(v_x) - steering_resistance(delta, v_x)
    front, rear = along * FRONT_LOAD / MASS, along * REAR_LOAD / MASS
    v_fx, v_fy, v_ry = contact_velocities(v_x, v_y, omega, delta)
    side, sin, cos = front_side_force(slip_angle(v_fx, v_fy)), np.sin(delta), np.cos(delta)
    at_front, at_rear = front * sin + side * cos, rear_side_force(slip_angle(v_x, v_ry))
    return np.array([front * cos + rear - side * sin, at_front + at_rear, L_F * at_front - L_R * at_rear])


class Turns(NamedTuple):
    """States of a car (n,): twist of its centre of gravity, wheel angle and throttle."""

    v_x: Floats
    v_y: Floats
    omega: Floats
    delta: Floats
    throttle: Floats


def steady_turns(v_x: Floats, delta: Floats) -> Turns:
    """The turns (n,) in which the authors' car stays at the speeds v_x (m/s) and wheel angles delta (rad)."""

    def unbalanced(x: Floats, v: float, angle: float) -> Floats:
        """Forces (N), the moment's over the wheelbase, that change the twist under v_y, omega and throttle in `x`."""
        v_y, omega, throttle = x
        F_x, F_y, M_z = wrench(v, v_y, omega, angle, throttle)
        return np.array([F_x + MASS * omega * v_y, F_y - MASS * omega * v, M_z / WHEELBASE])

    found = []
    for v, angle in zip(v_x, delta, strict=True):
        without_slip = v * np.tan(angle) / WHEELBASE
        solved = root(unbalanced, [L_R * without_slip, without_slip, 0.3], (v, angle), tol=1e-12).x
        if np.abs(unbalanced(solved, v, angle)).max() > 1e-9:
            raise ArithmeticError(f"no steady turn found at {v} m/s and {angle} rad")
        found.append(solved)
    v_y, omega, throttle = np.array(found).T
    return Turns(v_x, v_y, omega, delta, throttle)

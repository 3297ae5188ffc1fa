"""The Newton-Euler car written once more for the peers: one text for numpy, torch and casadi.

No code is shared with `bcid.physics`: that the peers agree with it is a check of both.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from bcid.physics.car import Car


class ElementaryFunctions(NamedTuple):
    """The elementary functions of one library."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    arctan: Callable[[Any], Any]
    minimum: Callable[[Any, Any], Any]
    maximum: Callable[[Any, Any], Any]
    absolute: Callable[[Any], Any]
    where: Callable[[Any, Any, Any], Any]


def state_rate(state: Any, u_s: Any, u_m: Any, p: Car, f: ElementaryFunctions) -> tuple[Any, Any, Any, Any]:
    """Time derivative of the state [v_x, v_y, omega, delta] (SI, body frame) of the Newton-Euler car `p`.

    u_s is the steering command (rad); u_m is the reference speed (m/s) where positive and the share of braking where
    negative.  All may be numbers, arrays or symbols of any library whose elementary functions are given as `f`.
    """
    v_x, v_y, omega, delta = state
    s, c = f.sin(delta), f.cos(delta)
    across = v_y + p.l_f * omega
    v_fx, v_fy = c * v_x + s * across, c * across - s * v_x

    def within(x: Any, low: Any, high: Any) -> Any:
        return f.minimum(f.maximum(x, low), high)

    def side(along: Any, v: Any, stiffness: float, most: float) -> Any:
        return within(-stiffness * f.arctan(v / f.maximum(f.absolute(along), p.v_0)), -most, most)

    pulls, brakes = within(p.K_t * (u_m - v_fx), 0.0, p.F_m_max), within(u_m * p.K_b * v_fx, -p.F_m_max, p.F_m_max)
    along = f.where(u_m >= 0.0, pulls, brakes) - p.R_1 * v_fx - p.R_2 * v_fx * f.absolute(v_fx)
    front, rear = side(v_fx, v_fy, p.C_f, p.F_f_max), side(v_x, v_y - p.l_r * omega, p.C_r, p.F_r_max)
    at_front = s * along + c * front
    return (
        (c * along - s * front) / p.m + omega * v_y, (at_front + rear) / p.m - omega * v_x,
        (p.l_f * at_front - p.l_r * rear) / p.I_z, within((u_s - delta) / p.T_s, -p.d, p.d),
    )  # fmt: skip


def advance_period(
    state: tuple[Any, ...], u_s: Any, u_m: Any, p: Car, period: float, f: ElementaryFunctions
) -> tuple[Any, ...]:
    """State [v_x, v_y, omega, delta] of the Newton-Euler car `p` after `period` (s), by two RK4 steps of `state_rate`.

    The commands u_s (rad) and u_m (m/s) are constant over the period; `f` has the library's elementary functions.
    """
    h = 0.5 * period
    for _ in range(2):
        k1 = state_rate(state, u_s, u_m, p, f)
        k2 = state_rate([x + 0.5 * h * k for x, k in zip(state, k1, strict=True)], u_s, u_m, p, f)
        k3 = state_rate([x + 0.5 * h * k for x, k in zip(state, k2, strict=True)], u_s, u_m, p, f)
        k4 = state_rate([x + h * k for x, k in zip(state, k3, strict=True)], u_s, u_m, p, f)
        state = tuple(
            x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d) for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)
        )
    return state

"""The steering actuator: first order with a rate limit (paper, App. actuators, deltaDot)."""

from __future__ import annotations

from bcid.compiled import njit


@njit
def steering_rate(u_s: float, delta: float, T_s: float, d: float) -> float:
    """Rate of the steering angle (rad/s): sat((u_s - delta)/T_s) within [-d, d]."""
    return min(max((u_s - delta) / T_s, -d), d)


@njit
def steering_step(delta: float, u_s: float, T_s: float, d: float, h: float) -> float:
    """The steering angle (rad) after `h` seconds (two RK4 substeps, as the Newton-Euler model)."""
    half = 0.5 * h
    for _ in range(2):
        k1 = steering_rate(u_s, delta, T_s, d)
        k2 = steering_rate(u_s, delta + 0.5 * half * k1, T_s, d)
        k3 = steering_rate(u_s, delta + 0.5 * half * k2, T_s, d)
        k4 = steering_rate(u_s, delta + half * k3, T_s, d)
        delta += half / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return delta

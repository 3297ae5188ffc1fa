"""A single-track car that is led along its measured speed: how it turns under the commands, whatever its motor does.

The speed v of the front hub is given, as measured.  The direction beta in which the hub moves and the yaw rate w are
states; F_f, F_r are the tyres' side forces per mass, P the drive's force per mass, s its share at the front axle:

    a_x = s P cos(delta) + (1 - s) P - F_f sin(delta)
    a_y = s P sin(delta) + F_f cos(delta) + F_r
    w'  = (l_f (s P sin(delta) + F_f cos(delta)) - l_r F_r) / j,        j = I_z / m
    A   = (a_x - l_f w^2, a_y + l_f w')                                 acceleration of the hub
    v'  = A . (cos(beta), sin(beta)),    v (beta' + w) = A . (-sin(beta), cos(beta))

The equation of v' gives P, so that motor, brake and drag need no law.  Tyres saturate softly: F = -g tanh(c alpha / g).
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.compiled.njit import njit, njit_inline
from bcid.physics.steering import steering_step

MAX_SUBSTEPS = 10
FASTEST_PER_STEP = 1.4  # of the fastest rate times a step; the midpoint rule is unstable from 2 on
LEAST_DRIVE_GAIN = 0.2  # of P on v': below it, the drive pulls across the hub's motion
LARGEST_TURN_RADPS = 60.0


class SingleTrack(NamedTuple):
    """Constants of the car, per mass, and of its steering."""

    l_f: float  # m
    l_r: float  # m
    front_share: float  # of the drive
    c_f: float  # m/s^2 per rad
    c_r: float
    g_f: float  # m/s^2
    g_r: float
    j: float  # m^2
    v_0: float  # m/s
    gain_left: float  # of the steering angle by the servo's
    gain_right: float
    trim: float  # rad


@njit
def servo_angles(
    command_s: Floats, u_s: Floats, time_s: Floats, T_s: float, d: float, delay_s: float
) -> Floats:  # fmt: skip
    """Servo angle (N,) in rad at the rising `time_s` (N,) under commands u_s (M,) in rad that act from `command_s` on.

    They act `delay_s` (s) later than stamped.  T_s (s) is the time constant, d (rad/s) the rate limit; the servo
    stands at the command that holds at the first time.
    """
    angle = np.empty(len(time_s))
    row = 0
    while row + 1 < len(command_s) and command_s[row + 1] + delay_s <= time_s[0]:
        row += 1
    delta, now = u_s[row], time_s[0]
    for k in range(len(time_s)):
        while row + 1 < len(command_s) and command_s[row + 1] + delay_s <= time_s[k]:
            change = command_s[row + 1] + delay_s
            delta = steering_step(delta, u_s[row], T_s, d, change - now)
            now = change
            row += 1
        delta = steering_step(delta, u_s[row], T_s, d, time_s[k] - now)
        now = time_s[k]
        angle[k] = delta
    return angle


@njit_inline
def _rates(beta: float, w: float, delta: float, v: float, v_rate: float, p: SingleTrack) -> tuple[float, float]:
    """Rates of the hub's direction beta (rad/s) and of the yaw rate w (rad/s^2) at the hub's speed `v` (m/s)."""
    along, across = v * math.cos(beta - delta), v * math.sin(beta - delta)
    v_x, v_ry = v * math.cos(beta), v * math.sin(beta) - (p.l_f + p.l_r) * w
    slip_f = math.atan(across / max(abs(along), p.v_0))
    slip_r = math.atan(v_ry / max(abs(v_x), p.v_0))
    F_f = -p.g_f * math.tanh(p.c_f * slip_f / p.g_f)
    F_r = -p.g_r * math.tanh(p.c_r * slip_r / p.g_r)
    sin_d, cos_d, sin_b, cos_b = math.sin(delta), math.cos(delta), math.sin(beta), math.cos(beta)
    front, rear = p.front_share, 1.0 - p.front_share
    a_x, a_y = -F_f * sin_d, F_f * cos_d + F_r
    w_rate = (p.l_f * F_f * cos_d - p.l_r * F_r) / p.j
    hub_x, hub_y = a_x - p.l_f * w * w, a_y + p.l_f * w_rate
    drive_w = p.l_f * front * sin_d / p.j
    drive_x, drive_y = front * cos_d + rear, front * sin_d + p.l_f * drive_w
    gain = drive_x * cos_b + drive_y * sin_b
    gain = math.copysign(max(abs(gain), LEAST_DRIVE_GAIN), gain)
    P = (v_rate - hub_x * cos_b - hub_y * sin_b) / gain
    hub_x, hub_y, w_rate = hub_x + P * drive_x, hub_y + P * drive_y, w_rate + P * drive_w
    return (hub_y * cos_b - hub_x * sin_b) / max(v, 0.1 * p.v_0) - w, w_rate


@njit
def turn_along(
    time_s: Floats, delta: Floats, v: Floats, v_rate: Floats, restart: Bools, beta_0: Floats, w_0: Floats,
    p: SingleTrack,
) -> Floats:  # fmt: skip
    """Yaw rate (N,) in rad/s of the car at the steering angles `delta` (N,) before trim and gains, led along its speed.

    Args:
        time_s: times (N,) in s.
        delta: servo angles (N,) in rad.
        v: speed (N,) of the front hub in m/s.
        v_rate: its rate (N,) in m/s^2.
        restart: rows (N,) at which direction and yaw rate begin anew.
        beta_0: direction (N,) in rad there.
        w_0: yaw rate (N,) in rad/s there.
        p: the car.
    """
    turn = np.empty(len(time_s))
    beta, w = beta_0[0], w_0[0]
    wheel = np.empty(len(time_s))
    for k in range(len(time_s)):
        wheel[k] = p.trim + (p.gain_left if delta[k] > 0.0 else p.gain_right) * delta[k]
    for k in range(len(time_s)):
        if restart[k]:
            beta, w = beta_0[k], w_0[k]
        turn[k] = w
        if k + 1 == len(time_s):
            break
        h = time_s[k + 1] - time_s[k]
        slow = max(v[k], p.v_0)
        fastest = (p.c_f * (1.0 + p.l_f**2 / p.j) + p.c_r * (1.0 + p.l_r**2 / p.j)) / slow
        steps = min(MAX_SUBSTEPS, max(1, math.ceil(h * fastest / FASTEST_PER_STEP)))
        for i in range(steps):
            a, b = (i + 0.5) / steps, i / steps
            v_a, v_b = v[k] + a * (v[k + 1] - v[k]), v[k] + b * (v[k + 1] - v[k])
            r_a, r_b = v_rate[k] + a * (v_rate[k + 1] - v_rate[k]), v_rate[k] + b * (v_rate[k + 1] - v_rate[k])
            d_a, d_b = wheel[k] + a * (wheel[k + 1] - wheel[k]), wheel[k] + b * (wheel[k + 1] - wheel[k])
            beta_rate, w_rate = _rates(beta, w, d_b, v_b, r_b, p)
            half = 0.5 * h / steps
            beta_rate, w_rate = _rates(beta + half * beta_rate, w + half * w_rate, d_a, v_a, r_a, p)
            beta += 2.0 * half * beta_rate
            w = min(max(w + 2.0 * half * w_rate, -LARGEST_TURN_RADPS), LARGEST_TURN_RADPS)
    return turn

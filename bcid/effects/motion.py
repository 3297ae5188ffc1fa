"""The car with effects in motion: the steering chain ahead of it, RK4 for the body, exact lags, the seen pose.

One fixed step `h` throughout; the steering chain is known at every half step, as RK4 asks for it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.lanes import where
from bcid.compiled.njit import njit, njit_inline
from bcid.effects import steering
from bcid.effects.car import Body, Drive, Lagged, Wrench, lag_after, wrench
from bcid.effects.constants import Constants
from bcid.physics.car import Car
from bcid.physics.elementary import sincos
from bcid.physics.steering import steering_step

SAME_TIME_S = 1e-9


class Chain(NamedTuple):
    """What the actuators give over n steps from t_0 on: the angle at every half step, the throttle in every step."""

    t_0: float
    h: float
    delta: Floats  # (2 n + 1,)
    u_m: Floats  # (n + 1,) as each step begins
    u_next: Floats  # (n + 1,) mean after the first change within the step
    late: Floats  # (n + 1,) share of the step after that change, 0 where there is none


class Given(NamedTuple):
    """What acts on the body in one step."""

    t: float  # s since the recording began, as the step begins
    T: float  # the recording's length, s
    delta: tuple[float, float, float]  # rad, as the step begins, in its middle and at its end
    u_m: float
    u_next: float
    late: float  # as in `Chain`
    push: tuple[float, float, float]  # a constant further wrench


class Servo(NamedTuple):
    """The steering on its way to the wheel, rad."""

    angle: float  # of the servo
    lagged: float  # behind its further lag
    behind: float  # behind its play


@njit
def mean_held(times: Floats, values: Floats, integral: Floats, a: float, b: float) -> float:
    """Mean over [a, b] of commands held from row to row; before the first row it stands.

    `integral` is the commands' running integral at `times`; the mean is a continuous function of a and b,
    so a delay has a gradient.
    """
    return (_integral(times, values, integral, b) - _integral(times, values, integral, a)) / (b - a)


@njit
def _integral(times: Floats, values: Floats, integral: Floats, t: float) -> float:
    k = max(int(np.searchsorted(times, t, side="right")) - 1, 0)
    return float(integral[k] + (t - times[k]) * values[k])


@njit
def servo_step(delta: float, u_s: float, T_s: float, d: float, band: float, skew: float, h: float) -> float:
    """The servo's angle after `h` seconds of constant command, with dead band and rate asymmetry, in closed form."""
    if band == 0.0 and skew == 0.0:
        return steering_step(delta, u_s, T_s, d, h)
    miss = u_s - delta
    if abs(miss) <= band:
        return delta
    limit = d * (1.0 + skew) if miss > 0.0 else d * (1.0 - skew)
    after = steering_step(delta, u_s, T_s, limit, h)
    if abs(u_s - after) < band:  # it stops where the band begins
        after = u_s - math.copysign(band, miss)
    return after


@njit
def steering_chain(
    times: Floats, commands: Floats, t_0: float, n: int, h: float, p: Car, limit: float, e: Any
) -> Chain:
    """Delay, servo, lag and play over `n` steps from `t_0`, from rest at the first command."""
    first = min(max(commands[0, 0], -limit), limit)
    return chain_on(Servo(first, first, first), times, commands, t_0, n, h, p, limit, e)[0]


@njit
def chain_on(
    servo: Servo, times: Floats, commands: Floats, t_0: float, n: int, h: float, p: Car, limit: float, e: Any
) -> tuple[Chain, Servo]:
    """The same from the steering as it stands at `t_0`; and the steering after the `n` steps.

    Half steps are divided where the delayed command changes: a servo at its rate limit answers to when a command
    came, not to its mean.
    """
    u_s, u_m = np.clip(commands[:, 0], -limit, limit), commands[:, 1].copy()
    half, tau = 0.5 * h, e.steering_delay__tau
    delta_out = np.empty(2 * n + 1)
    throttle, throttle_next, late = _throttle(times + e.motor_delay__tau, u_m, t_0, n, h)
    angle, lagged, behind = servo.angle, servo.lagged, servo.behind
    row = 0
    for k in range(2 * n + 1):
        t = t_0 + k * half
        lagging = lagged if e.steering_lag__tau > 0.0 else angle
        behind = steering.play(behind, lagging, e.steering_backlash__b) if e.steering_backlash__b > 0.0 else lagging
        delta_out[k] = behind
        now, end = t, t + half
        while k < 2 * n and now < end:
            while row + 1 < len(times) and times[row + 1] + tau <= now:
                row += 1
            until = min(times[row + 1] + tau, end) if row + 1 < len(times) else end
            after = servo_step(
                angle, u_s[row], p.T_s, p.d, e.steering_dead_band__b, e.steering_rate_asymmetry__a, until - now
            )  # fmt: skip
            if e.steering_lag__tau > 0.0:
                lagged = lag_after(lagged, angle, after, (until - now) / e.steering_lag__tau)
            angle, now = after, until
    return Chain(t_0, h, delta_out, throttle, throttle_next, late), Servo(angle, lagged, behind)


@njit
def _throttle(times: Floats, u_m: Floats, t_0: float, n: int, h: float) -> tuple[Floats, Floats, Floats]:
    """`Chain`'s throttle of commands held from `times` on."""
    area = np.zeros(len(times))
    area[1:] = np.cumsum(u_m[:-1] * np.diff(times))
    now, after, late = np.empty(n + 1), np.empty(n + 1), np.zeros(n + 1)
    for k in range(n + 1):
        t = t_0 + k * h
        row = int(np.searchsorted(times, t + SAME_TIME_S, side="right"))  # the next to come
        now[k] = after[k] = u_m[max(row - 1, 0)]
        if 0 < row < len(times) and times[row] < t + h - SAME_TIME_S:
            late[k] = (t + h - times[row]) / h
            after[k] = mean_held(times, u_m, area, times[row], t + h)
    return now, after, late


@njit
def _lagged_at(start: Lagged, first: Wrench, now: Wrench, ahead: float, p: Car, e: Any) -> Lagged:
    """The lagging quantities `ahead` seconds into a step that began with `start` and the wrench `first`."""
    alpha, F_f, F_r = now.steady.alpha_f, now.steady.F_mf, now.steady.F_mr
    if e.tyre_relaxation__sigma > 0.0:
        ratio = 0.5 * (abs(first.v_fx) + abs(now.v_fx)) * ahead / e.tyre_relaxation__sigma
        alpha = lag_after(start.alpha_f, first.steady.alpha_f, alpha, ratio)
    if e.motor_lag__tau > 0.0:
        ratio = ahead / e.motor_lag__tau
        F_f = lag_after(start.F_mf, first.steady.F_mf, F_f, ratio)
        F_r = lag_after(start.F_mr, first.steady.F_mr, F_r, ratio)
    return Lagged(alpha, F_f, F_r)


@njit
def _mean_behind(miss: float, ratio: float) -> float:
    """Mean over a step of what is left of `miss` while it fades, `ratio` time constants long."""
    fades = ratio > 1e-9
    return where(fades, miss * (1.0 - math.exp(-ratio)) / where(fades, ratio, 1.0), miss)


@njit
def _lagged_in(start: Lagged, first: Wrench, now: Wrench, ahead: float, h: float, p: Car, e: Any) -> Lagged:
    """The same for a stage of the step of `h` seconds, with the fading miss at the step's start as its mean.

    So a step's impulse is right however short the lag is: RK4's stages would miss what fades between them.
    """
    settling = Lagged(first.steady.alpha_f, first.steady.F_mf, first.steady.F_mr)
    at = _lagged_at(settling, first, now, ahead, p, e)
    alpha, F_f, F_r = at.alpha_f, at.F_mf, at.F_mr
    if e.tyre_relaxation__sigma > 0.0:
        alpha += _mean_behind(start.alpha_f - settling.alpha_f, abs(first.v_fx) * h / e.tyre_relaxation__sigma)
    if e.motor_lag__tau > 0.0:
        F_f += _mean_behind(start.F_mf - settling.F_mf, h / e.motor_lag__tau)
        F_r += _mean_behind(start.F_mr - settling.F_mr, h / e.motor_lag__tau)
    return Lagged(alpha, F_f, F_r)


@njit
def _rates(b: Body, w: Wrench, push_x: float, push_y: float, push_m: float, p: Car) -> Body:
    """Rates of pose and twist under the wrench and a further push on the body."""
    sin_t, cos_t = sincos(b.theta)
    return Body(
        cos_t * b.v_x - sin_t * b.v_y, sin_t * b.v_x + cos_t * b.v_y, b.omega,
        (w.F_x + push_x) / (w.heavier * p.m) + b.omega * b.v_y,
        (w.F_y + push_y) / (w.heavier * p.m) - b.omega * b.v_x,
        (w.M_z + push_m) / (w.heavier * p.I_z),
    )  # fmt: skip


@njit
def _moved(b: Body, r: Body, h: float) -> Body:
    return Body(
        b.p_x + h * r.p_x, b.p_y + h * r.p_y, b.theta + h * r.theta,
        b.v_x + h * r.v_x, b.v_y + h * r.v_y, b.omega + h * r.omega,
    )  # fmt: skip


@njit
def _wrench_under(lagged: Lagged, b: Body, drive: Drive, p: Car, e: Any, c: Constants) -> Wrench:
    """`wrench`, not inlined: where it is found a second time."""
    return wrench(b, drive, lagged, p, e, c)


@njit
def body_step(
    b: Body, lagged: Lagged, k: int, chain: Chain, T: float, push: Floats, p: Car, e: Any, c: Constants
) -> tuple[Body, Lagged]:
    """Pose, twist and lags after step `k` of the chain, one RK4 step; `push` (3,) is a constant further wrench."""
    return stepped(b, lagged, given_in(k, chain, T, push), chain.h, p, e, c)


@njit
def given_in(k: int, chain: Chain, T: float, push: Floats) -> Given:
    """What the chain gives in step `k`, and a further wrench `push` (3,)."""
    return Given(
        chain.t_0 + k * chain.h, T, (chain.delta[2 * k], chain.delta[2 * k + 1], chain.delta[2 * k + 2]),
        chain.u_m[k], chain.u_next[k], chain.late[k], (push[0], push[1], push[2]),
    )  # fmt: skip


@njit_inline
def stepped(b: Body, lagged: Lagged, given: Given, h: float, p: Car, e: Any, c: Constants) -> tuple[Body, Lagged]:
    """Pose, twist and lags after a step of `h` seconds with what acts on it `given`, of one car or of lanes."""
    t, T, u_m, u_next, s = given.t, given.T, given.u_m, given.u_next, given.late
    # weights of a change within the step that keep its impulse, s, and how far it carries, s^2/2; a lag smoothes both
    at_start, at_end = (s, s) if e.motor_lag__tau > 0.0 else (3.0 * s * s - 2.0 * s, 4.0 * s - 3.0 * s * s)
    start = Drive(t, T, given.delta[0], u_m, u_next, at_start)
    middle = Drive(t + 0.5 * h, T, given.delta[1], u_m, u_next, s)
    end = Drive(t + h, T, given.delta[2], u_m, u_next, at_end)
    # a lag's value at a stage follows from the steady one there: only then is the wrench found twice
    lags = e.motor_lag__tau > 0.0 or e.tyre_relaxation__sigma > 0.0
    first = wrench(b, start, lagged, p, e, c)
    w1 = first
    if lags:
        w1 = _wrench_under(_lagged_in(lagged, first, first, 0.0, h, p, e), b, start, p, e, c)
    k1 = _rates(b, w1, given.push[0], given.push[1], given.push[2], p)
    b2 = _moved(b, k1, 0.5 * h)
    w2 = wrench(b2, middle, lagged, p, e, c)
    if lags:
        w2 = _wrench_under(_lagged_in(lagged, first, w2, 0.5 * h, h, p, e), b2, middle, p, e, c)
    k2 = _rates(b2, w2, given.push[0], given.push[1], given.push[2], p)
    b3 = _moved(b, k2, 0.5 * h)
    w3 = wrench(b3, middle, _lagged_in(lagged, first, w2, 0.5 * h, h, p, e), p, e, c)
    k3 = _rates(b3, w3, given.push[0], given.push[1], given.push[2], p)
    b4 = _moved(b, k3, h)
    w4 = wrench(b4, end, lagged, p, e, c)
    after = _lagged_at(lagged, first, w4, h, p, e)
    if lags:
        w4 = _wrench_under(_lagged_in(lagged, first, w4, h, h, p, e), b4, end, p, e, c)
    k4 = _rates(b4, w4, given.push[0], given.push[1], given.push[2], p)
    total = Body(
        k1.p_x + 2.0 * k2.p_x + 2.0 * k3.p_x + k4.p_x, k1.p_y + 2.0 * k2.p_y + 2.0 * k3.p_y + k4.p_y,
        k1.theta + 2.0 * k2.theta + 2.0 * k3.theta + k4.theta, k1.v_x + 2.0 * k2.v_x + 2.0 * k3.v_x + k4.v_x,
        k1.v_y + 2.0 * k2.v_y + 2.0 * k3.v_y + k4.v_y, k1.omega + 2.0 * k2.omega + 2.0 * k3.omega + k4.omega,
    )  # fmt: skip
    return _moved(b, total, h / 6.0), after


@njit
def settled(b: Body, k: int, chain: Chain, T: float, p: Car, e: Any, c: Constants) -> Lagged:
    """The lagging quantities at step `k` as if nothing had changed for long."""
    return settled_in(b, given_in(k, chain, T, np.zeros(3)), p, e, c)


@njit
def settled_in(b: Body, given: Given, p: Car, e: Any, c: Constants) -> Lagged:
    """The lagging quantities, as if nothing had changed for long, where a step begins in which so much is `given`."""
    drive = Drive(given.t, given.T, given.delta[0], given.u_m, given.u_next, 0.0)
    return wrench(b, drive, Lagged(0.0, 0.0, 0.0), p, e, c).steady


@njit
def drive_on(b: Body, k: int, n: int, chain: Chain, T: float, p: Car, e: Any, c: Constants) -> Floats:
    """States (n + 1, 6) at steps k to k + n, [p_x, p_y, theta, v_x, v_y, omega]; lags start settled."""
    out = np.empty((n + 1, 6))
    push = np.zeros(3)
    lagged = settled(b, k, chain, T, p, e, c)
    for i in range(n + 1):
        out[i, 0], out[i, 1], out[i, 2] = b.p_x, b.p_y, b.theta
        out[i, 3], out[i, 4], out[i, 5] = b.v_x, b.v_y, b.omega
        if i < n:
            b, lagged = body_step(b, lagged, k + i, chain, T, push, p, e, c)
    return out

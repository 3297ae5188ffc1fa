"""The body in motion under all effects: RK4 with exact lags, from what the actuators give."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.effects import motor, tyres
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import Actuation, BodyState, LagState, Wrench, is_lagging, wrench_with_effects
from bcid.effects.constants import Constants
from bcid.effects.lags import decay_at_stage
from bcid.effects.remainder import no_remainder
from bcid.effects.unnamed_action import add_remainder
from bcid.physics.car import Car
from bcid.physics.elementary import sincos


class StepInputs(NamedTuple):
    """What acts on the body in one step."""

    t: float  # s since the recording began, as the step begins
    T: float  # the recording's length, s
    delta: tuple[float, float, float]  # rad, as the step begins, in its middle and at its end
    u_m: float
    u_next: float
    late: float  # share of the step after the throttle's change to u_next
    brake: float  # brake share, its mean over the step
    push: tuple[float, float, float]  # a constant further wrench


@njit
def advance_lags(start: LagState, first: Wrench, now: Wrench, ahead: float, e: Switches) -> LagState:
    """Lagging slip angle (rad) and motor forces (N) `ahead` seconds into a step that begins with the values `start`.

    Each follows its steady value by a first-order lag, the slip angle over the distance rolled, the forces over
    time.  The steady values run linearly from those of `first`, the wrench at the step's start, to those of `now`.  A
    quantity whose lag is off in `e` equals its steady value.
    """
    rolled = 0.5 * (abs(first.v_fx) + abs(now.v_fx)) * ahead
    a, b, sigma, tau = first.steady, now.steady, e.tyre_relaxation__sigma, e.motor_lag__tau
    return LagState(
        tyres.tyre_relaxation(start.alpha_f, a.alpha_f, b.alpha_f, rolled, sigma),
        motor.motor_lag(start.F_mf, a.F_mf, b.F_mf, ahead, tau),
        motor.motor_lag(start.F_mr, a.F_mr, b.F_mr, ahead, tau),
    )


@njit
def lags_at_stage(start: LagState, first: Wrench, now: Wrench, ahead: float, h: float, e: Switches) -> LagState:
    """Lagging slip angle (rad) and motor forces (N) for the RK4 stage `ahead` seconds into a step of `h` seconds.

    `start` holds their values as the step begins, `first` and `now` the wrenches there and at the stage.  The initial
    deviation from the steady value decays exponentially; the stages' values keep the step's impulse and how far it
    carries even for time constants far below `h`, which RK4 would not resolve.
    """
    steady, share = first.steady, ahead / h
    at = advance_lags(steady, first, now, ahead, e)
    alpha, F_f, F_r = at.alpha_f, at.F_mf, at.F_mr
    if e.tyre_relaxation__sigma > 0.0:
        rolled = abs(first.v_fx) * h / e.tyre_relaxation__sigma
        alpha += decay_at_stage(start.alpha_f - steady.alpha_f, rolled, share)
    if e.motor_lag__tau > 0.0:
        F_f += decay_at_stage(start.F_mf - steady.F_mf, h / e.motor_lag__tau, share)
        F_r += decay_at_stage(start.F_mr - steady.F_mr, h / e.motor_lag__tau, share)
    return LagState(alpha, F_f, F_r)


@njit
def body_rates(b: BodyState, w: Wrench, push: tuple[float, float, float], p: Car) -> BodyState:
    """Time derivatives of pose (world) and twist (body) of a car `p` under the wrench `w` and a disturbance `push`.

    `push` is a force and moment (N, N, N m) in the body frame that is added to `w`; mass and inertia are multiplied
    by the wrench's mass factor.
    """
    sin_t, cos_t = sincos(b.theta)
    return BodyState(
        cos_t * b.v_x - sin_t * b.v_y, sin_t * b.v_x + cos_t * b.v_y, b.omega,
        (w.F_x + push[0]) / (w.mass_factor * p.m) + b.omega * b.v_y,
        (w.F_y + push[1]) / (w.mass_factor * p.m) - b.omega * b.v_x,
        (w.M_z + push[2]) / (w.mass_factor * p.I_z),
    )  # fmt: skip


@njit
def add_rates(b: BodyState, r: BodyState, h: float) -> BodyState:
    """Pose and twist b + h r after `h` seconds at the constant rates `r`."""
    return BodyState(
        b.p_x + h * r.p_x, b.p_y + h * r.p_y, b.theta + h * r.theta,
        b.v_x + h * r.v_x, b.v_y + h * r.v_y, b.omega + h * r.omega,
    )  # fmt: skip


@njit
def step_inputs(k: int, chain: ActuatorChain, T: float, push: Floats) -> StepInputs:
    """Time, steering angles, throttle and disturbance that act in step `k` of the actuator chain.

    `T` is the recording's length (s), `push` (3,) a constant disturbance force and moment on the body (N, N, N m).
    """
    return StepInputs(
        chain.t_0 + k * chain.h, T, (chain.delta[2 * k], chain.delta[2 * k + 1], chain.delta[2 * k + 2]),
        chain.u_m[k], chain.u_next[k], chain.late[k], chain.brake[k], (push[0], push[1], push[2]),
    )  # fmt: skip


@njit
def stage_actuation(stage: int, inputs: StepInputs, h: float) -> Actuation:
    """What the actuators give at `stage` (0 to 3) of an RK4 step of `h` seconds under `inputs`.

    Stages 0 and 3 are the step's ends, 1 and 2 its middle.  A throttle that changes within the step is averaged with
    weights that keep its impulse, s, and how far it carries, s^2/2, which a motor's lag does as well.
    """
    s = inputs.late
    weight = 3.0 * s * s - 2.0 * s if stage == 0 else (4.0 * s - 3.0 * s * s if stage == 3 else s)
    delta = inputs.delta[0] if stage == 0 else (inputs.delta[2] if stage == 3 else inputs.delta[1])
    t = inputs.t + stage_time(stage) * h
    rate = (inputs.delta[2] - inputs.delta[0]) / h
    return Actuation(t, inputs.T, delta, rate, inputs.u_m, inputs.u_next, weight, inputs.brake, no_remainder(delta))


@njit
def stage_time(stage: int) -> float:
    """Share of an RK4 step that has passed at its `stage`, 0 to 3: 0, 1/2, 1/2, 1."""
    return 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)


@njit
def stage_weight(stage: int) -> float:
    """Weight of the rates at `stage` (0 to 3) among those that an RK4 step adds up to six: 1, 2, 2, 1."""
    return 1.0 if stage == 0 or stage == 3 else 2.0  # noqa: PLR1714


@njit_inline
def rk4_body_step(
    b: BodyState, lags: LagState, inputs: StepInputs, h: float, p: Car, e: Switches, c: Constants
) -> tuple[BodyState, LagState]:
    """Pose, twist and lagging quantities after one RK4 step of `h` seconds under `inputs`, with the effects on in `e`.

    `b` and `lags` hold as the step begins.  Their fields are numbers, or vectors of numbers for as many cars side by
    side.
    """
    zero = 0.0 * b.v_x
    # a lag's value at a stage follows from the steady one there: only then is the wrench computed twice
    lagging = is_lagging(e)
    rate = total = BodyState(zero, zero, zero, zero, zero, zero)
    first = now = Wrench(zero, zero, zero, zero, lags, zero)
    after = lags
    for stage in range(4):  # a loop, so that the wrench's machine code is there once
        act, ahead = stage_actuation(stage, inputs, h), stage_time(stage) * h
        there = add_rates(b, rate, ahead)
        act = add_remainder(act, there, p, e)
        # the third stage is at the time of the second, whose steady values serve it
        twice, at = lagging and stage != 2, lags
        if stage == 2:
            at = lags_at_stage(lags, first, now, ahead, h, e)
        for evaluation in range(2 if twice else 1):
            now = wrench_with_effects(there, act, at, p, e, c)
            if evaluation == 0:
                if stage == 0:
                    first = now
                if stage == 3:
                    after = advance_lags(lags, first, now, h, e)
                if twice:
                    at = lags_at_stage(lags, first, now, ahead, h, e)
        rate = body_rates(there, now, inputs.push, p)
        total = add_rates(total, rate, stage_weight(stage))
    return add_rates(b, total, h / 6.0), after


@njit
def steady_lags(b: BodyState, act: Actuation, p: Car, e: Switches, c: Constants) -> LagState:
    """Front slip angle (rad) and motor forces (N) in steady state at pose and twist `b`, at an unchanging throttle."""
    unchanged = Actuation(
        act.t, act.T, act.delta, act.delta_rate, act.u_m, act.u_next, 0.0 * act.late, act.brake, act.rest
    )  # fmt: skip
    return wrench_with_effects(b, add_remainder(unchanged, b, p, e), LagState(0.0, 0.0, 0.0), p, e, c).steady


@njit
def integrate_body(
    b: BodyState, lags: LagState, k: int, n: int, chain: ActuatorChain, T: float, pushes: Floats, steps_per_push: int,
    p: Car, e: Switches, c: Constants,
) -> Floats:  # fmt: skip
    """Pose, twist and lagging quantities from step `k` of the actuator chain to step k + n, by RK4: rows (n + 1, 9).

    A row is [p_x, p_y, theta (world), v_x, v_y, omega (body), alpha_f (rad), F_mf, F_mr (N)]; `unpack_body` and
    `unpack_lags` read it.  `b` and `lags` hold as step `k` begins.  Each of the `pushes` (q, 3), disturbance forces
    and moments on the body (N, N, N m), acts for `steps_per_push` steps, the last until the end.  `T` is the
    recording's length (s).
    """
    out = np.empty((n + 1, 9))
    for i in range(n + 1):
        out[i, 0], out[i, 1], out[i, 2] = b.p_x, b.p_y, b.theta
        out[i, 3], out[i, 4], out[i, 5] = b.v_x, b.v_y, b.omega
        out[i, 6], out[i, 7], out[i, 8] = lags.alpha_f, lags.F_mf, lags.F_mr
        if i < n:
            push = pushes[min(i // steps_per_push, len(pushes) - 1)]
            b, lags = rk4_body_step(b, lags, step_inputs(k + i, chain, T, push), chain.h, p, e, c)
    return out

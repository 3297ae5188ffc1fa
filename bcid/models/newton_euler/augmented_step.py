"""The Newton-Euler car with effects, one period after the other, compiled.

The carry holds pose and twist, lagging quantities, the steering on its way to the wheel, time, and delayed commands.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.njit import njit
from bcid.effects.actuators import ActuatorChain, SteeringState, continue_actuator_chain
from bcid.effects.car import BodyState, LagState, unpack_body, unpack_lags
from bcid.effects.constants import Constants
from bcid.effects.measurement import to_pose_clock
from bcid.effects.motion import integrate_body
from bcid.likelihood.lane_start import first_lags_of_one
from bcid.physics.car import Car

N_MOTION = 13  # numbers of the carry before the commands: body, lags, steering and time


class AugmentedSetup(NamedTuple):
    """All that a step needs beside the carry: the car, its effects and the grid of time."""

    car: Car
    switches: Switches
    constants: Constants
    limit: float  # of the steering command, rad
    T: float  # length of the recording in the equations of the effects, s
    period: float  # s
    steps: int  # integration steps in a period
    kept: int  # earlier commands in the carry, enough for the longest delay


class AugmentedState(NamedTuple):
    """The carry unpacked: body, lags and steering of the car, the time, and the commands held back."""

    body: BodyState
    lagged: LagState
    servo: SteeringState
    t: float  # s since the take began
    commands: Floats  # (kept, 4) time (s), u_s, u_m, brake share of the commands before


@njit
def pack_carry(state: AugmentedState) -> Floats:
    """The flat carry (13 + 4 kept,), a Newton-Euler car's state between two steps, made of the structured `state`.

    [p_x, p_y, theta (world), v_x, v_y (body), omega, alpha_f, F_mf, F_mr, three steering angles, t], SI units, then the
    last `kept` commands [time, u_s, u_m, brake share]; alpha_f and the motor forces lag, the angles are those of the
    steering chain.
    """
    b, l, s = state.body, state.lagged, state.servo  # noqa: E741  # beside b and s
    x = np.empty(N_MOTION + state.commands.size)
    x[0], x[1], x[2], x[3], x[4], x[5] = b.p_x, b.p_y, b.theta, b.v_x, b.v_y, b.omega
    x[6], x[7], x[8], x[9], x[10], x[11], x[12] = l.alpha_f, l.F_mf, l.F_mr, s.angle, s.lagged, s.behind, state.t
    x[N_MOTION:] = state.commands.ravel()
    return x


@njit
def unpack_carry(x: Floats) -> AugmentedState:
    """The structured state of a car with effects, from its flat carry `x` (13 + 4 kept,); undoes `pack_carry`."""
    return AugmentedState(
        unpack_body(x), unpack_lags(x), SteeringState(x[9], x[10], x[11]), x[12], x[N_MOTION:].copy().reshape(-1, 4)
    )


@njit
def tracked_twist(b: BodyState, e: Switches) -> tuple[float, float, float]:
    """v_x, v_y (m/s), yaw rate (rad/s) of the tracked point in its own axes, from the car's twist `b` at its CoG.

    (1 + kappa) R(-psi) (v + w x d), w: with the marker's offset d, yaw misalignment psi and length-scale error kappa
    in `e`.
    """
    v_x, v_y = b.v_x - b.omega * e.marker_offset__d_y, b.v_y + b.omega * e.marker_offset__d_x
    grown, psi = 1.0 + e.pose_scale__kappa, e.body_yaw_misalignment__psi
    sin_p, cos_p = math.sin(psi), math.cos(psi)
    return grown * (cos_p * v_x + sin_p * v_y), grown * (cos_p * v_y - sin_p * v_x), b.omega


@njit
def body_from_tracked(pose: Floats, twist: Floats, e: Switches) -> BodyState:
    """Pose and twist of the car at its CoG, from the tracked `pose` [x, y, yaw] (world) and `twist` (its own axes).

    It undoes the marker's offset, the yaw misalignment and the length-scale error that are parameters of the effects
    `e`.
    """
    grown, psi = 1.0 + e.pose_scale__kappa, e.body_yaw_misalignment__psi
    d_x, d_y = e.marker_offset__d_x, e.marker_offset__d_y
    theta, omega = pose[2] - psi, twist[2]
    sin_t, cos_t, sin_p, cos_p = math.sin(theta), math.cos(theta), math.sin(psi), math.cos(psi)
    return BodyState(
        pose[0] / grown - cos_t * d_x + sin_t * d_y, pose[1] / grown - sin_t * d_x - cos_t * d_y, theta,
        (cos_p * twist[0] - sin_p * twist[1]) / grown + omega * d_y,
        (sin_p * twist[0] + cos_p * twist[1]) / grown - omega * d_x, omega,
    )  # fmt: skip


@njit
def command_arrivals(commands: Floats, s: AugmentedSetup) -> Floats:
    """Times (n,) (s) on the poses' clock at which `commands` (n, 4), [time, u_s, u_m, brake share], are given.

    They are shifted by the poses' latency and the drift of their clock, both effects in `s`.  The clock is no further
    off beyond the recording's end than there.
    """
    time_s = commands[:, 0].copy()
    within = np.minimum(time_s, s.T)
    return to_pose_clock(within, s.switches) + (time_s - within)


@njit
def _append_parts(commands: Floats, parts: Floats, t: float) -> Floats:
    """Commands (n + m, 4), [time, u_s, u_m, brake share]: earlier `commands` (n, 4), m parts of a period from `t` on.

    `parts` (W, 4) are [duration (s), u_s, u_m, brake share]; those without duration are left out.
    """
    n = len(commands)
    out = np.empty((n + len(parts), 4))
    out[:n] = commands
    for j in range(len(parts)):
        if parts[j, 0] > 0.0:
            out[n, 0], out[n, 1:] = t, parts[j, 1:]
            t, n = t + parts[j, 0], n + 1
    return out[:n]


@njit
def initial_state(
    b: BodyState, delta: float, commands: Floats, periods: int, t: float, s: AugmentedSetup
) -> AugmentedState:
    """State at time `t` (s) of a car with effects whose body is at `b`, its steering simulated under the past commands.

    The steering starts at `delta` (rad), `periods` periods before `t`; the first of `commands` (n, 4), [time (s), u_s,
    u_m, brake share], is given then or earlier.  A lagging front slip angle has its steady value; lagging motor forces
    are what the throttle has left since then.
    """
    n, h, e = periods * s.steps, s.period / s.steps, s.switches
    still, begin = SteeringState(delta, delta, delta), t - periods * s.period
    arrivals, values = command_arrivals(commands, s), commands[:, 1:].copy()
    chain, servo = continue_actuator_chain(still, arrivals, values, begin, n, h, s.car, s.limit, e)
    lagged = first_lags_of_one(b, n, n, chain, s.T, s.car, e, s.constants)
    kept = np.empty((s.kept, 4))
    for i in range(s.kept):
        kept[i] = commands[max(len(commands) - s.kept + i, 0)]
    return AugmentedState(b, lagged, servo, t, kept)


class PeriodActuation(NamedTuple):
    """What the actuators do in one period."""

    chain: ActuatorChain
    servo: SteeringState  # at the period's end
    commands: Floats  # (kept, 4) held back for the next


@njit
def actuate_period(state: AugmentedState, parts: Floats, s: AugmentedSetup) -> PeriodActuation:
    """What the actuators give in the period after `state` under its commands `parts` (W, 4).

    A part is [duration (s), u_s (rad), u_m, brake share].
    """
    commands = _append_parts(state.commands, parts, state.t)
    values = commands[:, 1:].copy()
    chain, servo = continue_actuator_chain(
        state.servo, command_arrivals(commands, s), values, state.t, s.steps, s.period / s.steps, s.car, s.limit,
        s.switches,
    )  # fmt: skip
    return PeriodActuation(chain, servo, commands[len(commands) - s.kept :].copy())


@njit
def integrate_period(state: AugmentedState, act: PeriodActuation, s: AugmentedSetup) -> AugmentedState:
    """State of a car with effects one period after `state`, its body integrated by RK4 as the actuators `act`."""
    no_pushes = np.zeros((1, 3))
    end = integrate_body(
        state.body, state.lagged, 0, s.steps, act.chain, s.T, no_pushes, s.steps, s.car, s.switches, s.constants
    )[s.steps]  # fmt: skip
    return AugmentedState(unpack_body(end), unpack_lags(end), act.servo, state.t + s.period, act.commands)


@njit
def advance_augmented(state: AugmentedState, parts: Floats, s: AugmentedSetup) -> AugmentedState:
    """State of a car with effects one period after `state` under the period's commands `parts` (W, 4)."""
    return integrate_period(state, actuate_period(state, parts, s), s)


@njit
def scan_augmented(carry: Floats, parts: Floats, s: AugmentedSetup) -> Floats:
    """Twists (N, 3) of a car with effects, at the tracked point and in its axes, after each of N periods.

    Commands are `parts` (N, W, 4), [duration (s), u_s, u_m, brake share].  `carry` (13 + 4 kept,), body, lags,
    steering, time and earlier commands (`pack_carry`), is advanced in place.
    """
    twists = np.empty((len(parts), 3))
    state = unpack_carry(carry)
    for k in range(len(parts)):
        state = advance_augmented(state, parts[k], s)
        twists[k, 0], twists[k, 1], twists[k, 2] = tracked_twist(state.body, s.switches)
    carry[:] = pack_carry(state)
    return twists

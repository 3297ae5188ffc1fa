"""How segments begin: body states as given, tyres in steady state, motor forces as the throttle before has left them.

A lagging motor's force as a segment begins is found by going through the throttle before it, a few time constants of
the lag, in steps in closed form.  Its steady value depends on the speed, too, which is followed back from that at the
beginning: its rate differs from that at the beginning, v_x'(t) = v_x'(0) + (F(t) - F(0))/m, by the motor's own force
F(t) along the car, all other forces taken as they are at the beginning.  That needs the forces' course, which is first
found at the speed of the beginning, then at the speeds that follow from it.  All is smooth in the car's parameters, and
nothing is gone through where nothing lags.
"""

import numpy as np

from bcid.aliases import Floats, Ints, Switches
from bcid.compiled.lane_access import gather_lanes, load_lanes, store_lanes
from bcid.compiled.lanes import LANES, where
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import Actuation, BodyState, LagState, wrench_with_effects
from bcid.effects.constants import Constants
from bcid.effects.motor_past import (
    follow_throttle,
    forward_acceleration,
    forward_pull,
    mean_age_in_step,
    motor_forces_at,
    remembered_steps,
)
from bcid.effects.remainder import no_remainder
from bcid.effects.unnamed_action import add_remainder
from bcid.likelihood.lane_rollout import LaneSegments, Rollout, step_inputs_in_lanes
from bcid.physics.car import Car
from bcid.physics.elementary import sincos

# times that the throttle is gone through: the first at one speed
PASSES = 3
# s over which the speed is followed back: beyond, what else acts on the car is not what it is at the beginning
FOLLOWED_S = 0.5


@njit
def begin_rollout(x: Floats, lanes: LaneSegments, chain: ActuatorChain, p: Car, e: Switches, c: Constants) -> Rollout:
    """Body and lag states of LANES segments at step 0, from initial states `x` (6, LANES).

    The lags are those of tyres, in steady state, and of motor forces, which the throttle before has left.

    Rows of `x` are p_x, p_y, theta (world, m and rad), v_x, v_y (body, m/s), omega (rad/s).  `p` are the car's
    constants, `e` the effects' parameters, `c` constants in the effects' equations that are not fitted.
    """
    b, act = load_body(x), first_actuation(lanes, chain)
    return Rollout(b, first_lags(b, add_remainder(act, b, p, e), known_steps(lanes, chain), lanes, chain, p, e, c), 0)


@njit
def known_steps(lanes: LaneSegments, chain: ActuatorChain) -> Ints:
    """Numbers of steps (LANES,) between the beginnings of the recordings and those of the segments in the lanes."""
    return np.floor(lanes.begin / chain.h + 1e-6).astype(np.int64)


@njit_inline
def load_body(x: Floats) -> BodyState:
    """Pose and twist of LANES cars from the array `x` (6, LANES) of p_x, p_y, theta, v_x, v_y, omega."""
    flat = x.reshape(x.size)
    return BodyState(
        load_lanes(flat, 0), load_lanes(flat, LANES), load_lanes(flat, 2 * LANES), load_lanes(flat, 3 * LANES),
        load_lanes(flat, 4 * LANES), load_lanes(flat, 5 * LANES),
    )  # fmt: skip


@njit_inline
def first_actuation(lanes: LaneSegments, chain: ActuatorChain) -> Actuation:
    """What the actuators give as the segments in the lanes begin, the throttle unchanging."""
    first = step_inputs_in_lanes(lanes, 0, chain, np.zeros(3 * LANES), 0)
    rate = (first.delta[2] - first.delta[0]) / chain.h
    none = 0.0 * first.late
    return Actuation(
        first.t, first.T, first.delta[0], rate, first.u_m, first.u_next, none, first.brake, no_remainder(none)
    )


@njit
def first_lags(
    b: BodyState, act: Actuation, past: Ints, lanes: LaneSegments, chain: ActuatorChain, p: Car, e: Switches,
    c: Constants,
) -> LagState:  # fmt: skip
    """Front slip angle (rad) and motor forces (N) of the cars at `b` as the segments in the lanes begin.

    The slip angle is the steady one.  `act` is what the actuators give then, with what the remainder adds at `b`; the
    throttle before is the chain's over the `past` steps (LANES,), and the motor is taken to be steady as these begin.
    """
    w = wrench_with_effects(b, act, LagState(0.0, 0.0, 0.0), p, e, c)
    n = remembered_steps(past.max(), chain.h, e)
    if n == 0:
        return w.steady
    lags, v_fx = w.steady, w.v_fx
    # at each step's end, counted backward from the segment's beginning
    slower, pull = np.zeros((n + 1) * LANES), np.zeros((n + 1) * LANES)
    for _ in range(PASSES):
        lags = _go_through_throttle(pull, slower, w.steady, b.v_x, v_fx, n, act, past, lanes, chain, p, e, c)
        w = wrench_with_effects(b, act, lags, p, e, c)
        rate, last = forward_acceleration(b, w, p), forward_pull(lags, act, p)
        change, later = 0.0 * rate, rate
        for i in range(1, n + 1):
            earlier = rate + (load_lanes(pull, i * LANES) - last) / (w.mass_factor * p.m)
            if i * chain.h <= FOLLOWED_S:
                change -= 0.5 * chain.h * (earlier + later)
                # it did not come through standstill
                change = where((b.v_x + change) * b.v_x < 0.0, -b.v_x, change)
            store_lanes(change, slower, i * LANES)
            later = earlier
    return lags


@njit
def _go_through_throttle(
    pull: Floats, slower: Floats, steady: LagState, v_rx: float, v_fx: float, n: int, act: Actuation, past: Ints,
    lanes: LaneSegments, chain: ActuatorChain, p: Car, e: Switches, c: Constants,
) -> LagState:  # fmt: skip
    """Lagging motor forces (N) after `n` steps of the throttle before the segments in the lanes.

    The wheels' speeds are `v_fx`, `v_rx` (m/s) at the end, and differ from them by `slower`, along the car, at the end
    of each step, the last first: n + 1 vectors.  The motor's force (N) along the car there is written to `pull`.
    `past` (LANES,) are the steps before whose throttle is known.
    """
    cos_d, lags, back_in_step = sincos(act.delta)[1], steady, mean_age_in_step(chain.h / e.motor_lag__tau)
    step, time, acts = np.empty(LANES, dtype=np.int64), np.empty(LANES), np.empty(LANES)
    for i in range(n + 1, 0, -1):
        # a segment whose recording has begun within this time waits at the recording's first throttle
        for lane in range(LANES):
            back = min(i, n, past[lane])
            step[lane], time[lane] = lanes.step[lane] - back, lanes.begin[lane] - back * chain.h
            acts[lane] = 1.0 if back == i else 0.0
        late = gather_lanes(chain.late, step, 0) * load_lanes(acts, 0)
        u_m, u_next = gather_lanes(chain.u_m, step, 0), gather_lanes(chain.u_next, step, 0)
        then = Actuation(
            load_lanes(time, 0), act.T, act.delta, act.delta_rate, u_m, u_next, late, act.brake, act.rest
        )  # fmt: skip
        change, before = load_lanes(slower, (i - 1) * LANES), load_lanes(slower, min(i, n) * LANES)
        change += back_in_step * (before - change)
        front, rear = v_fx + cos_d * change, v_rx + change
        if i > n:
            lags = motor_forces_at(lags, front, rear, then, p, e, c)
        else:
            lags = follow_throttle(lags, front, rear, then, chain.h, p, e, c)
        store_lanes(forward_pull(lags, act, p), pull, (i - 1) * LANES)
    return lags


@njit
def first_lags_of_one(
    b: BodyState, k: int, past: int, chain: ActuatorChain, T: float, p: Car, e: Switches, c: Constants
) -> LagState:
    """Front slip angle (rad) and motor forces (N) of one car at `b` as step `k` of the actuator chain begins.

    As `first_lags`, from the throttle of the `past` steps before it, at most k.  `T` is the recording's length (s).
    """
    x, out, none = np.empty((6, LANES)), np.empty(3 * LANES), np.zeros(LANES, dtype=np.int64)
    x[0], x[1], x[2], x[3], x[4], x[5] = b.p_x, b.p_y, b.theta, b.v_x, b.v_y, b.omega
    begin = np.full(LANES, chain.t_0 + k * chain.h)
    lanes = LaneSegments(none, none + k, none + 2 * k, begin, np.full(LANES, T))
    abreast = load_body(x)
    act = add_remainder(first_actuation(lanes, chain), abreast, p, e)
    lags = first_lags(abreast, act, none + past, lanes, chain, p, e, c)
    store_lanes(lags.alpha_f, out, 0)
    store_lanes(lags.F_mf, out, LANES)
    store_lanes(lags.F_mr, out, 2 * LANES)
    return LagState(out[0], out[LANES], out[2 * LANES])


@njit
def steps_of_recording(k: int, chain: ActuatorChain) -> int:
    """Number of steps before step `k` of the actuator chain that lie in the recording, whose time begins at 0 s."""
    return min(k, int(np.floor(chain.t_0 / chain.h + k + 1e-6)))

"""Rollouts of LANES segments at a time, side by side in vector registers: the path of the tracked point."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints, Switches
from bcid.compiled.lane_access import gather_lanes, load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import BodyState, LagState
from bcid.effects.constants import Constants
from bcid.effects.measurement import marker_offset
from bcid.effects.motion import StepInputs, rk4_body_step
from bcid.likelihood.take import KNOTS, N_START, Take
from bcid.physics.car import Car
from bcid.physics.elementary import sincos


class SegmentLayout(NamedTuple):
    """The part of a `Take` that predictions need: where each segment's stamps and rows are (fields as there)."""

    stamp_s: Floats
    row: Ints
    share: Floats
    first_stamp: Ints
    first: Ints
    step: Ints
    steps: int
    zero_s: Floats
    length_s: Floats


def segment_layout(take: Take) -> SegmentLayout:
    """The fields of `take` that compiled predictions read: times (s) of poses, their rows, where segments begin.

    A row is the mean of the poses within 0.05 s; a segment begins at a pose, a row and an integration step.
    """
    return SegmentLayout(*(getattr(take, field) for field in SegmentLayout._fields))


@njit
def shift_chain_time(chain: ActuatorChain, zero: float) -> ActuatorChain:
    """The actuator chain (steering angle, throttle at each integration step), `zero` (s) subtracted from its times."""
    return ActuatorChain(chain.t_0 - zero, chain.h, chain.delta, chain.u_m, chain.u_next, chain.late, chain.brake)


class LaneSegments(NamedTuple):
    """One segment for each lane; the last segment of a take may fill several lanes."""

    s: Ints  # (LANES,) segments
    step: Ints  # (LANES,) integration steps at which they begin
    half: Ints  # (LANES,) the same in half steps
    begin: Floats  # (LANES,) time (s) from the beginning of the recording to that of the segment
    length: Floats  # (LANES,) length (s) of the recording


class Rollout(NamedTuple):
    """The states of the segments in all lanes after `i` integration steps."""

    b: BodyState
    lagged: LagState
    i: int


PATH_SIZE, PATH_RATE = 6, 3  # a row of a path holds x, y, yaw, and from index 3 on their rates


@njit
def segments_in_lanes(first: int, layout: SegmentLayout, chain: ActuatorChain) -> LaneSegments:
    """Indices, first steps and times of segments `first` to `first + LANES - 1`, one in each lane of a vector register.

    Past the end of the take, its last segment fills the lanes that are left.
    """
    # a parallel loop counts without signs
    s = np.minimum(np.arange(LANES) + np.int64(first), len(layout.step) - 1)
    step = layout.step[s]
    return LaneSegments(s, step, 2 * step, chain.t_0 + step * chain.h - layout.zero_s[s], layout.length_s[s])


@njit
def allocate_path(steps: int) -> Floats:
    """Uninitialised array (steps + 1, PATH_SIZE, LANES) for x, y, yaw and their time derivatives of LANES segments."""
    return np.empty((steps + 1, PATH_SIZE, LANES))


@njit
def gather_nuisance(start: Floats, lanes: LaneSegments) -> Floats:
    """Initial states and pushes (N_NUISANCE, LANES) of the segments in the lanes, from `start` (S, N_NUISANCE)."""
    return np.ascontiguousarray(start[lanes.s].T)


@njit
def push_wrenches(nuisance: Floats, p: Car) -> Floats:
    """Disturbance wrenches F_x, F_y (N), M_z (N m) (KNOTS, 3, ...) of the pushes: m or I_z times accelerations.

    `nuisance` (N_NUISANCE, ...) holds the initial state, then a_x, a_y (m/s^2, body frame), alpha_z (rad/s^2) in each
    third of a segment.
    """
    wrench = nuisance[N_START:].copy().reshape((KNOTS, 3, *nuisance.shape[1:]))
    wrench[:, :2] *= p.m
    wrench[:, 2] *= p.I_z
    return wrench


@njit_inline
def step_inputs_in_lanes(lanes: LaneSegments, i: int, chain: ActuatorChain, pushes: Floats, at: int) -> StepInputs:
    """Time, steering angles, throttles and disturbance wrench that act on the body of each lane in step `i`.

    The wrenches F_x, F_y, M_z (N, N, N m) begin at index `at` of the flat array `pushes`, LANES numbers each.
    """
    return StepInputs(
        load_lanes(lanes.begin, 0) + i * chain.h, load_lanes(lanes.length, 0),
        (gather_lanes(chain.delta, lanes.half, 2 * i), gather_lanes(chain.delta, lanes.half, 2 * i + 1),
         gather_lanes(chain.delta, lanes.half, 2 * i + 2)),
        gather_lanes(chain.u_m, lanes.step, i), gather_lanes(chain.u_next, lanes.step, i),
        gather_lanes(chain.late, lanes.step, i), gather_lanes(chain.brake, lanes.step, i),
        (load_lanes(pushes, at), load_lanes(pushes, at + LANES), load_lanes(pushes, at + 2 * LANES)),
    )  # fmt: skip


@njit_inline
def store_pose(path: Floats, i: int, b: BodyState, e: Switches) -> None:
    """Write the tracked point's x, y (m), the yaw (rad) of every lane, and their time derivatives, to row `i`.

    All are in the world.  The tracked point stands at the marker offset in `e`; scale and misalignment of the tracking
    are not applied.
    """
    flat, at = path.reshape(path.size), i * PATH_SIZE * LANES
    sin_t, cos_t = sincos(b.theta)
    d_x, d_y = e.marker_offset__d_x, e.marker_offset__d_y
    x, y = marker_offset(b.p_x, b.p_y, b.theta, d_x, d_y)
    v_x, v_y = b.v_x - d_y * b.omega, b.v_y + d_x * b.omega
    store_lanes(x, flat, at)
    store_lanes(y, flat, at + LANES)
    store_lanes(b.theta, flat, at + 2 * LANES)
    store_lanes(cos_t * v_x - sin_t * v_y, flat, at + 3 * LANES)
    store_lanes(sin_t * v_x + cos_t * v_y, flat, at + 4 * LANES)
    store_lanes(b.omega, flat, at + 5 * LANES)


@njit
def integrate_segments(
    path: Floats, rollout: Rollout, until: int, pushes: Floats, lanes: LaneSegments, chain: ActuatorChain, p: Car,
    e: Switches, c: Constants,
) -> Rollout:  # fmt: skip
    """Integrate LANES segments by RK4 from `rollout` to step `until`, writing poses to `path`; return the last state.

    `path` is (steps + 1, PATH_SIZE, LANES).  Each of the n wrenches F_x, F_y, M_z (N, N, N m; body frame) in `pushes`
    (n, 3, LANES) acts for an nth of the path.  `p` are the car's constants, `e` the effects' parameters.
    """
    b, lagged = rollout.b, rollout.lagged
    each, flat = (len(path) - 1) // len(pushes), pushes.reshape(pushes.size)
    store_pose(path, rollout.i, b, e)
    for i in range(rollout.i, until):
        inputs = step_inputs_in_lanes(lanes, i, chain, flat, 3 * LANES * (i // each))
        b, lagged = rk4_body_step(b, lagged, inputs, chain.h, p, e, c)
        store_pose(path, i + 1, b, e)
    return Rollout(b, lagged, until)

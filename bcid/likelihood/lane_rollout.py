"""Rollouts of LANES segments at a time, side by side in vector registers, and the tracked poses along them."""

from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.compiled.lane_access import gather_lanes, load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import Actuation, BodyState, LagState
from bcid.effects.constants import Constants
from bcid.effects.measurement import tracked_pose
from bcid.effects.motion import StepInputs, rk4_body_step, steady_lags
from bcid.likelihood.take import Take
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
    """The stamps, rows and integration steps of the segments of `take`, as compiled predictions take them."""
    return SegmentLayout(*(getattr(take, field) for field in SegmentLayout._fields))


@njit
def shift_chain_time(chain: ActuatorChain, zero: float) -> ActuatorChain:
    """The actuator chain with its time counted from `zero` (s), when a recording began."""
    return ActuatorChain(chain.t_0 - zero, chain.h, chain.delta, chain.u_m, chain.u_next, chain.late)


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
    """Steps and times of the segments `first` to `first + LANES`, one in each lane."""
    # a parallel loop counts without signs
    s = np.minimum(np.arange(LANES) + np.int64(first), len(layout.step) - 1)
    step = layout.step[s]
    return LaneSegments(s, step, 2 * step, chain.t_0 + step * chain.h - layout.zero_s[s], layout.length_s[s])


@njit
def segment_in_all_lanes(s: int, layout: SegmentLayout, chain: ActuatorChain) -> LaneSegments:
    """Steps and times of segment `s`, repeated in all lanes."""
    here = segments_in_lanes(s, layout, chain)
    same = np.zeros(LANES, dtype=np.int64)
    return LaneSegments(here.s[same], here.step[same], here.half[same], here.begin[same], here.length[same])


@njit
def allocate_path(steps: int) -> Floats:
    """An empty array (steps + 1, PATH_SIZE, LANES) for the poses of LANES segments and their rates."""
    return np.empty((steps + 1, PATH_SIZE, LANES))


@njit_inline
def _step_inputs(lanes: LaneSegments, i: int, chain: ActuatorChain, pushes: Floats, at: int) -> StepInputs:
    """Commands, times and pushes that act on the lanes in step `i`; their pushes begin at index `at` of `pushes`."""
    return StepInputs(
        load_lanes(lanes.begin, 0) + i * chain.h, load_lanes(lanes.length, 0),
        (gather_lanes(chain.delta, lanes.half, 2 * i), gather_lanes(chain.delta, lanes.half, 2 * i + 1),
         gather_lanes(chain.delta, lanes.half, 2 * i + 2)),
        gather_lanes(chain.u_m, lanes.step, i), gather_lanes(chain.u_next, lanes.step, i),
        gather_lanes(chain.late, lanes.step, i),
        (load_lanes(pushes, at), load_lanes(pushes, at + LANES), load_lanes(pushes, at + 2 * LANES)),
    )  # fmt: skip


@njit_inline
def _store_pose(path: Floats, i: int, b: BodyState) -> None:
    """Write the pose of every lane and its rates in the world to row `i` of `path`."""
    flat, at = path.reshape(path.size), i * PATH_SIZE * LANES
    sin_t, cos_t = sincos(b.theta)
    store_lanes(b.p_x, flat, at)
    store_lanes(b.p_y, flat, at + LANES)
    store_lanes(b.theta, flat, at + 2 * LANES)
    store_lanes(cos_t * b.v_x - sin_t * b.v_y, flat, at + 3 * LANES)
    store_lanes(sin_t * b.v_x + cos_t * b.v_y, flat, at + 4 * LANES)
    store_lanes(b.omega, flat, at + 5 * LANES)


@njit
def begin_rollout(x: Floats, lanes: LaneSegments, chain: ActuatorChain, p: Car, e: Any, c: Constants) -> Rollout:
    """Rollouts that begin at the lanes' initial states `x` (6, LANES), with lags in their steady state."""
    flat = x.reshape(x.size)
    b = BodyState(
        load_lanes(flat, 0), load_lanes(flat, LANES), load_lanes(flat, 2 * LANES), load_lanes(flat, 3 * LANES),
        load_lanes(flat, 4 * LANES), load_lanes(flat, 5 * LANES),
    )  # fmt: skip
    first = _step_inputs(lanes, 0, chain, np.zeros(3 * LANES), 0)
    act = Actuation(first.t, first.T, first.delta[0], first.u_m, first.u_next, 0.0)
    return Rollout(b, steady_lags(b, act, p, e, c), 0)


@njit
def integrate_segments(
    path: Floats, rollout: Rollout, until: int, pushes: Floats, lanes: LaneSegments, chain: ActuatorChain, p: Car,
    e: Any, c: Constants,
) -> Rollout:  # fmt: skip
    """Integrate the lanes from `rollout` to step `until`, write the pose of each step to `path`, and return the end.

    Each of the n wrenches `pushes` (n, 3, LANES) acts for an nth of the path's steps.
    """
    b, lagged = rollout.b, rollout.lagged
    each, flat = (len(path) - 1) // len(pushes), pushes.reshape(pushes.size)
    _store_pose(path, rollout.i, b)
    for i in range(rollout.i, until):
        inputs = _step_inputs(lanes, i, chain, flat, 3 * LANES * (i // each))
        b, lagged = rk4_body_step(b, lagged, inputs, chain.h, p, e, c)
        _store_pose(path, i + 1, b)
    return Rollout(b, lagged, until)


@njit_inline
def _interpolate_pose(path: Floats, i: int, j: int, lane: int, u: float, h: float) -> float:
    """Coordinate `j` (x, y, yaw) at the share `u` of step `i`, h s long: the cubic through its values and rates."""
    a, b = path[i, j, lane], path[i + 1, j, lane]
    rate_a, rate_b = path[i, PATH_RATE + j, lane], path[i + 1, PATH_RATE + j, lane]
    between: float = (
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * a + u * (1.0 - u) ** 2 * h * rate_a
        + u * u * (3.0 - 2.0 * u) * b - u * u * (1.0 - u) * h * rate_b
    )  # fmt: skip
    return between


@njit
def observe_poses(
    out: Floats, path: Floats, lane: int, first_step: int, lanes: LaneSegments, layout: SegmentLayout, h: float, e: Any
) -> None:
    """Add a lane's tracked poses at stamps after `first_step` to its rows `out` (n, 3), as shares of their means."""
    s, steps = lanes.s[lane], len(path) - 1
    begin, first = layout.zero_s[s] + lanes.begin[lane], layout.first[s]
    for j in range(layout.first_stamp[s], layout.first_stamp[s + 1]):
        at = (layout.stamp_s[j] - begin) / h
        i = min(max(int(np.ceil(at)) - 1, 0), steps - 1)
        if i < first_step:
            continue
        u = at - i
        x, y, yaw = tracked_pose(
            _interpolate_pose(path, i, 0, lane, u, h), _interpolate_pose(path, i, 1, lane, u, h),
            _interpolate_pose(path, i, 2, lane, u, h), e,
        )  # fmt: skip
        row, share = layout.row[j] - first, layout.share[j]
        out[row, 0] += share * x
        out[row, 1] += share * y
        out[row, 2] += share * yaw

"""LANES segments at a time, next to each other in vector registers: their ways, and what poses are seen on them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.compiled.lanes import LANES, gather, load, store
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import Body, Lagged
from bcid.effects.constants import Constants
from bcid.effects.measurement import seen_pose
from bcid.effects.motion import Chain, Given, settled_in, stepped
from bcid.likelihood.take import Take
from bcid.physics.car import Car
from bcid.physics.elementary import sincos


class Layout(NamedTuple):
    """Where the segments' stamps and rows are: the part of a `Take` that predictions need."""

    stamps: Floats
    row: Ints
    share: Floats
    first_stamp: Ints
    first: Ints
    step: Ints
    steps: int
    zero: Floats
    length: Floats


def layout(take: Take) -> Layout:
    """The layout of `take`."""
    return Layout(
        take.stamp_s, take.row, take.share, take.first_stamp, take.first, take.step, take.steps, take.zero_s,
        take.length_s,
    )  # fmt: skip


@njit
def since(chain: Chain, zero: float) -> Chain:
    """The chain with its time counted from `zero`, where a recording began."""
    return Chain(chain.t_0 - zero, chain.h, chain.delta, chain.u_m, chain.u_next, chain.late)


class Segments(NamedTuple):
    """Some of them, abreast; the last may stand there several times."""

    s: Ints  # (LANES,)
    step: Ints  # (LANES,) at which they begin
    half: Ints  # (LANES,) the same in half steps
    begin: Floats  # (LANES,) when, since their recordings began
    length: Floats  # (LANES,) how long these are


class Way(NamedTuple):
    """How far segments have been driven."""

    b: Body
    lagged: Lagged
    i: int  # steps


POSITION, RATE = 0, 3  # in a row of a path: x, y, yaw, then their rates
ON_PATH = 6


@njit
def segments_from(first: int, of: Layout, chain: Chain) -> Segments:
    """Those from `first` on."""
    s = np.minimum(np.arange(LANES) + np.int64(first), len(of.step) - 1)  # a parallel loop counts without signs
    step = of.step[s]
    return Segments(s, step, 2 * step, chain.t_0 + step * chain.h - of.zero[s], of.length[s])


@njit
def segment_alone(s: int, of: Layout, chain: Chain) -> Segments:
    """One segment, in all lanes."""
    here = segments_from(s, of, chain)
    same = np.zeros(LANES, dtype=np.int64)
    return Segments(here.s[same], here.step[same], here.half[same], here.begin[same], here.length[same])


@njit
def new_path(steps: int) -> Floats:
    """Room for the ways of LANES segments: (steps + 1, ON_PATH, LANES)."""
    return np.empty((steps + 1, ON_PATH, LANES))


@njit_inline
def _given(mine: Segments, i: int, chain: Chain, pushes: Floats, at: int) -> Given:
    """What acts on the segments in step `i`; `at` is where their push stands among `pushes`."""
    return Given(
        load(mine.begin, 0) + i * chain.h, load(mine.length, 0),
        (gather(chain.delta, mine.half, 2 * i), gather(chain.delta, mine.half, 2 * i + 1),
         gather(chain.delta, mine.half, 2 * i + 2)),
        gather(chain.u_m, mine.step, i), gather(chain.u_next, mine.step, i), gather(chain.late, mine.step, i),
        (load(pushes, at), load(pushes, at + LANES), load(pushes, at + 2 * LANES)),
    )  # fmt: skip


@njit_inline
def _put(path: Floats, i: int, b: Body) -> None:
    """Write pose and its rates to the path, after `i` steps."""
    flat, at = path.reshape(path.size), i * ON_PATH * LANES
    sin_t, cos_t = sincos(b.theta)
    store(b.p_x, flat, at)
    store(b.p_y, flat, at + LANES)
    store(b.theta, flat, at + 2 * LANES)
    store(cos_t * b.v_x - sin_t * b.v_y, flat, at + 3 * LANES)
    store(sin_t * b.v_x + cos_t * b.v_y, flat, at + 4 * LANES)
    store(b.omega, flat, at + 5 * LANES)


@njit
def begun(x: Floats, mine: Segments, chain: Chain, p: Car, e: Any, c: Constants) -> Way:
    """The beginning of segments in the states `x` (6, LANES), their lags settled."""
    flat = x.reshape(x.size)
    b = Body(
        load(flat, 0), load(flat, LANES), load(flat, 2 * LANES), load(flat, 3 * LANES),
        load(flat, 4 * LANES), load(flat, 5 * LANES),
    )  # fmt: skip
    return Way(b, settled_in(b, _given(mine, 0, chain, np.zeros(3 * LANES), 0), p, e, c), 0)


@njit
def driven(
    path: Floats, way: Way, until: int, pushes: Floats, mine: Segments, chain: Chain, p: Car, e: Any, c: Constants
) -> Way:
    """The way after `until` steps, all of it on the path.

    Under `pushes` (n, 3, LANES), wrenches, each for an nth of the path's steps.
    """
    b, lagged = way.b, way.lagged
    each, flat = (len(path) - 1) // len(pushes), pushes.reshape(pushes.size)
    _put(path, way.i, b)
    for i in range(way.i, until):
        b, lagged = stepped(b, lagged, _given(mine, i, chain, flat, 3 * LANES * (i // each)), chain.h, p, e, c)
        _put(path, i + 1, b)
    return Way(b, lagged, until)


@njit_inline
def _between(path: Floats, i: int, j: int, lane: int, u: float, h: float) -> float:
    """Coordinate `j` at the share `u` of the step of `h` s from `i` on: cubic between its values, with their rates."""
    a, b = path[i, POSITION + j, lane], path[i + 1, POSITION + j, lane]
    rate_a, rate_b = path[i, RATE + j, lane], path[i + 1, RATE + j, lane]
    between: float = (
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * a + u * (1.0 - u) ** 2 * h * rate_a
        + u * u * (3.0 - 2.0 * u) * b - u * u * (1.0 - u) * h * rate_b
    )  # fmt: skip
    return between


@njit
def see(out: Floats, path: Floats, lane: int, first_step: int, mine: Segments, of: Layout, h: float, e: Any) -> None:
    """Add the poses seen from `first_step` on, each with its share, to their segment's rows `out` (n, 3)."""
    s, steps = mine.s[lane], len(path) - 1
    begin, first = of.zero[s] + mine.begin[lane], of.first[s]
    for j in range(of.first_stamp[s], of.first_stamp[s + 1]):
        at = (of.stamps[j] - begin) / h
        i = min(max(int(np.ceil(at)) - 1, 0), steps - 1)
        if i < first_step:
            continue
        u = at - i
        x, y, yaw = seen_pose(
            _between(path, i, 0, lane, u, h), _between(path, i, 1, lane, u, h), _between(path, i, 2, lane, u, h),
            e.marker_offset__d_x, e.marker_offset__d_y, e.body_yaw_misalignment__psi, e.pose_scale__kappa,
        )  # fmt: skip
        row, share = of.row[j] - first, of.share[j]
        out[row, 0] += share * x
        out[row, 1] += share * y
        out[row, 2] += share * yaw

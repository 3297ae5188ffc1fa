"""Predicted poses of all segments, and how they answer to initial states and to pushes on the body."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from bcid.aliases import Floats
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_parallel
from bcid.effects.car import alike_everywhere
from bcid.effects.constants import Constants
from bcid.effects.motion import Chain
from bcid.likelihood.lane_rollout import Layout, Segments, begun, driven, new_path, see, segments_from
from bcid.likelihood.take import KNOTS, N_FREE, N_START
from bcid.physics.car import Car

NUDGE = 1e-3  # of the initial state (m, rad, m/s, rad/s): wide enough that a kink met or missed does not rule
N_POSE = 3  # of the initial state, in the world
PUSH = 1e-2  # of the pushes (m/s^2, rad/s^2)


@njit
def free_of(start: Floats, mine: Segments) -> Floats:
    """The free parts of segments abreast, (N_FREE, LANES), of those of all, `start` (S, N_FREE)."""
    return np.ascontiguousarray(start[mine.s].T)


@njit
def pushes_of(free: Floats, p: Car) -> Floats:
    """The wrenches (KNOTS, 3, ...) in free parts (N_FREE, ...), which hold them as accelerations."""
    wrench = free[N_START:].copy().reshape((KNOTS, 3, *free.shape[1:]))
    wrench[:, :2] *= p.m
    wrench[:, 2] *= p.I_z
    return wrench


@njit
def _count_from(first: int, of: Layout) -> int:
    """How many of the segments abreast from `first` on there are."""
    return min(LANES, len(of.step) - first)


@njit_parallel
def predict(of: Layout, start: Floats, chain: Chain, p: Car, e: Any, c: Constants) -> Floats:
    """Mean poses (N, 3) of all rows from the segments' initial states and under their pushes, `start` (S, N_FREE).

    Here as in `free_sensitivities`, `e` is an array of one record: a parallel loop cannot be handed the record.
    """
    out = np.zeros((of.first[-1], 3))
    for group in numba.prange((len(of.step) + LANES - 1) // LANES):
        mine, path = segments_from(group * LANES, of, chain), new_path(of.steps)
        free = free_of(start, mine)
        way = begun(free[:N_START], mine, chain, p, e[0], c)
        driven(path, way, of.steps, pushes_of(free, p), mine, chain, p, e[0], c)
        for k in range(_count_from(group * LANES, of)):
            see(out[of.first[mine.s[k]] :], path, k, 0, mine, of, chain.h, e[0])
    return out


@njit_parallel
def free_sensitivities(of: Layout, start: Floats, chain: Chain, p: Car, e: Any, c: Constants) -> Floats:
    """D pose / d `start`, (N, 3, N_FREE), by differences; of a car that drives alike everywhere, it moves as one."""
    out, rigid = np.zeros((of.first[-1], 3, N_FREE)), alike_everywhere(e[0])
    for group in numba.prange((len(of.step) + LANES - 1) // LANES):
        mine, count = segments_from(group * LANES, of, chain), _count_from(group * LANES, of)
        free, path, each = free_of(start, mine), new_path(of.steps), of.steps // KNOTS
        pushes = pushes_of(free, p)
        for j in range(N_POSE if rigid else 0, N_START):
            x = free[:N_START].copy()
            x[j] += NUDGE
            driven(path, begun(x, mine, chain, p, e[0], c), of.steps, pushes, mine, chain, p, e[0], c)
            for k in range(count):
                see(out[of.first[mine.s[k]] :, :, j], path, k, 0, mine, of, chain.h, e[0])
        way, still = begun(free[:N_START], mine, chain, p, e[0], c), new_path(of.steps)
        for knot in range(KNOTS):  # a push changes nothing before it begins
            for j in range(N_START + 3 * knot, N_START + 3 * (knot + 1)):
                moved = free.copy()
                moved[j] += PUSH
                driven(path, way, of.steps, pushes_of(moved, p), mine, chain, p, e[0], c)
                for k in range(count):
                    see(out[of.first[mine.s[k]] :, :, j], path, k, knot * each, mine, of, chain.h, e[0])
            way = driven(still, way, (knot + 1) * each, pushes, mine, chain, p, e[0], c)
        for k in range(count):
            f, g = of.first[mine.s[k]], of.first[mine.s[k] + 1]
            for knot in range(KNOTS):
                seen = np.zeros((g - f, 3))
                see(seen, still, k, knot * each, mine, of, chain.h, e[0])
                for j in range(N_START + 3 * knot, N_START + 3 * (knot + 1)):
                    out[f:g, :, j] = (out[f:g, :, j] - seen) / PUSH
                if knot == 0:
                    for j in range(N_START):
                        out[f:g, :, j] = (out[f:g, :, j] - seen) / NUDGE
                    if rigid:
                        _move_as_one(out[f:g], seen, free[:N_POSE, k], 1.0 + e[0].pose_scale__kappa)
    return out


@njit
def _move_as_one(out: Floats, seen: Floats, pose: Floats, scale: float) -> None:
    """How poses `seen` (n, 3) answer to the pose that they begin with, in whose frame they stay where they are."""
    out[:, :, :N_POSE] = 0.0
    out[:, 0, 0] = scale
    out[:, 1, 1] = scale
    out[:, 0, 2] = scale * pose[1] - seen[:, 1]
    out[:, 1, 2] = seen[:, 0] - scale * pose[0]
    out[:, 2, 2] = 1.0


def half_steps(T: float, h: float) -> int:
    """Integration steps of `h` seconds that cover a recording of `T` seconds."""
    return math.ceil(T / h) + 2


@np.errstate(invalid="ignore")
def wrapped(residual: Floats) -> Floats:
    """The residual (N, 3) with its yaw in (-pi, pi]; what has left the finite numbers stays outside."""
    residual = residual.copy()
    residual[:, 2] -= 2.0 * np.pi * np.round(residual[:, 2] / (2.0 * np.pi))
    return residual

"""Predicted poses of all segments, and their derivatives by initial states and by pushes on the body."""

import numba
import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_parallel
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import is_pose_independent
from bcid.effects.constants import Constants
from bcid.likelihood.lane_rollout import (
    LaneSegments,
    SegmentLayout,
    allocate_path,
    begin_rollout,
    integrate_segments,
    observe_poses,
    segments_in_lanes,
)
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START
from bcid.physics.car import Car

# difference steps of initial states (m, rad, m/s, rad/s), wide enough that a kink met or missed does not rule, and of
# pushes (m/s^2, rad/s^2)
STATE_STEP, PUSH_STEP = 1e-3, 1e-2
N_POSE = 3  # leading components of an initial state: the pose in the world


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


@njit_parallel
def predict_poses(
    layout: SegmentLayout, start: Floats, chain: ActuatorChain, p: Car, e: Switches, c: Constants
) -> Floats:
    """Predicted poses (N, 3) x, y (m), yaw (rad) of the tracked point, averaged over 0.05 s as the measured ones are.

    Every segment is integrated from its own initial state under its own pushes (constant disturbances over 0.5 s),
    the rows of `start` (S, N_NUISANCE).  `p` are the car's constants, `c` those of the effects' equations, `e` the
    effects' parameters as an array of one record, since a parallel loop cannot be handed the record.
    """
    out = np.zeros((layout.first[-1], 3))
    for group in numba.prange((len(layout.step) + LANES - 1) // LANES):
        lanes, path = segments_in_lanes(group * LANES, layout, chain), allocate_path(layout.steps)
        nuisance = gather_nuisance(start, lanes)
        begin = begin_rollout(nuisance[:N_START], lanes, chain, p, e[0], c)
        integrate_segments(path, begin, layout.steps, push_wrenches(nuisance, p), lanes, chain, p, e[0], c)
        for k in range(min(LANES, len(layout.step) - group * LANES)):
            observe_poses(out[layout.first[lanes.s[k]] :], path, k, 0, lanes, layout, chain.h, e[0])
    return out


@njit_parallel
def pose_sensitivities(
    layout: SegmentLayout, start: Floats, chain: ActuatorChain, p: Car, e: Switches, c: Constants
) -> Floats:
    """Derivatives (N, 3, N_NUISANCE) of predicted poses by initial states and pushes, by forward differences.

    `start` (S, N_NUISANCE) holds each segment's initial state and pushes (constant disturbances over 0.5 s).
    Derivatives by the initial pose are exact (a rigid motion of the whole path) where no force depends on the pose.
    """
    out, rigid = np.zeros((layout.first[-1], 3, N_NUISANCE)), is_pose_independent(e[0])
    for group in numba.prange((len(layout.step) + LANES - 1) // LANES):
        lanes, count = segments_in_lanes(group * LANES, layout, chain), min(LANES, len(layout.step) - group * LANES)
        nuisance, path, each = gather_nuisance(start, lanes), allocate_path(layout.steps), layout.steps // KNOTS
        pushes = push_wrenches(nuisance, p)
        for j in range(N_POSE if rigid else 0, N_START):
            x = nuisance[:N_START].copy()
            x[j] += STATE_STEP
            begin = begin_rollout(x, lanes, chain, p, e[0], c)
            integrate_segments(path, begin, layout.steps, pushes, lanes, chain, p, e[0], c)
            for k in range(count):
                observe_poses(out[layout.first[lanes.s[k]] :, :, j], path, k, 0, lanes, layout, chain.h, e[0])
        rollout, still = begin_rollout(nuisance[:N_START], lanes, chain, p, e[0], c), allocate_path(layout.steps)
        for knot in range(KNOTS):  # a push changes nothing before it begins
            for j in range(N_START + 3 * knot, N_START + 3 * (knot + 1)):
                moved = nuisance.copy()
                moved[j] += PUSH_STEP
                integrate_segments(path, rollout, layout.steps, push_wrenches(moved, p), lanes, chain, p, e[0], c)
                for k in range(count):
                    observe_poses(
                        out[layout.first[lanes.s[k]] :, :, j], path, k, knot * each, lanes, layout, chain.h, e[0]
                    )
            rollout = integrate_segments(still, rollout, (knot + 1) * each, pushes, lanes, chain, p, e[0], c)
        for k in range(count):
            f, g = layout.first[lanes.s[k]], layout.first[lanes.s[k] + 1]
            for knot in range(KNOTS):
                seen = np.zeros((g - f, 3))
                observe_poses(seen, still, k, knot * each, lanes, layout, chain.h, e[0])
                for j in range(N_START + 3 * knot, N_START + 3 * (knot + 1)):
                    out[f:g, :, j] = (out[f:g, :, j] - seen) / PUSH_STEP
                if knot == 0:
                    for j in range(N_START):
                        out[f:g, :, j] = (out[f:g, :, j] - seen) / STATE_STEP
                    if rigid:
                        _rigid_sensitivities(out[f:g], seen, nuisance[:N_POSE, k], 1.0 + e[0].pose_scale__kappa)
    return out


@njit
def _rigid_sensitivities(out: Floats, seen: Floats, pose: Floats, scale: float) -> None:
    """Write to `out` (n, 3, N_NUISANCE) exact derivatives of tracked poses `seen` (n, 3) by the initial `pose` (3,).

    The whole path moves with x, y, yaw of the initial pose as a rigid body; `scale` is the tracking's length scale.
    """
    out[:, :, :N_POSE] = 0.0
    out[:, 0, 0] = scale
    out[:, 1, 1] = scale
    out[:, 0, 2] = scale * pose[1] - seen[:, 1]
    out[:, 1, 2] = seen[:, 0] - scale * pose[0]
    out[:, 2, 2] = 1.0


@np.errstate(invalid="ignore")
def wrap_yaw(residual: Floats) -> Floats:
    """A copy of the residual (N, 3) in x, y (m), yaw (rad), its yaw wrapped to [-pi, pi]; NaN and infinities stay."""
    residual = residual.copy()
    residual[:, 2] -= 2.0 * np.pi * np.round(residual[:, 2] / (2.0 * np.pi))
    return residual

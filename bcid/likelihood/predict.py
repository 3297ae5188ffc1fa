"""Predicted poses of all segments, and their derivatives by initial states and by pushes on the body."""

import numba
import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_parallel
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import varies_with_pose
from bcid.effects.constants import Constants
from bcid.likelihood.lane_rollout import (
    SegmentLayout,
    allocate_path,
    gather_nuisance,
    integrate_segments,
    push_wrenches,
    segments_in_lanes,
)
from bcid.likelihood.lane_start import begin_rollout
from bcid.likelihood.linearised_rollout import ALONG, Resolution, linearise_segments
from bcid.likelihood.observe import apply_tracking, observe_means
from bcid.likelihood.step_matrix import N_PUSH
from bcid.likelihood.take import KNOTS, N_START
from bcid.physics.car import Car

COARSE = Resolution(KNOTS, 0)  # by pushes alone
FINE = Resolution(12, 1)  # by accelerations and turns of the wheel in each 0.125 s
N_POSE = 3  # leading components of an initial state: the pose in the world


@njit_parallel
def predict_poses(
    layout: SegmentLayout, start: Floats, chain: ActuatorChain, p: Car, e: Switches, c: Constants
) -> Floats:
    """Predicted poses (N, 3) x, y (m), yaw (rad) of the tracked point, averaged over 0.05 s as the measured ones are.

    Every segment is integrated from its own initial state under its own pushes (constant disturbances over 0.25 s),
    the rows of `start` (S, N_NUISANCE).  `p` are the car's constants, `c` those of the effects' equations, `e` the
    effects' parameters as an array of one record, since a parallel loop cannot be handed the record.
    """
    out = np.zeros((layout.first[-1], 3, 1))
    for group in numba.prange((len(layout.step) + LANES - 1) // LANES):
        lanes, path = segments_in_lanes(group * LANES, layout, chain), allocate_path(layout.steps)
        nuisance = gather_nuisance(start, lanes)
        begin = begin_rollout(nuisance[:N_START], lanes, chain, p, e[0], c)
        integrate_segments(path, begin, layout.steps, push_wrenches(nuisance, p), lanes, chain, p, e[0], c)
        count = min(LANES, len(layout.step) - group * LANES)
        observe_means(out, layout.first[lanes.s], path, count, lanes, layout, chain.h)
    poses = out[:, :, 0].copy()
    apply_tracking(poses, e[0])
    return poses


@njit_parallel
def linearise_poses(
    layout: SegmentLayout, start: Floats, chain: ActuatorChain, cars: Floats, widths: Floats, resolution: Resolution,
    e: Switches, c: Constants,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Predicted poses (N, 3), their derivatives (N, 3, C) by the variational equation, and what the car is at.

    The C columns are by initial states (N_START), by R parameters, then for each knot of the `resolution` by
    accelerations a_x, a_y, alpha_z of the body in it, and by a turn of the steered wheel where that is asked for, at
    initial states and pushes in the rows of `start` (S, N_NUISANCE).  What the car is at, (S, knots, ALONG), are the
    quantities on which a remainder depends, and the heading, in the middle of each knot.
    `cars` (R + 1, 22) are the car's constants, then those with one parameter changed each, by `widths` (R,) of its
    own.
    """
    N, S, knots, pulled = layout.first[-1], len(layout.step), resolution.knots, varies_with_pose(e[0])
    columns = N_START + len(widths) + (N_PUSH + resolution.turns) * knots
    out, derivatives, along = np.zeros((N, 3, 1)), np.zeros((N, 3, columns)), np.empty((S, knots, ALONG))
    scale = 1.0 + e[0].pose_scale__kappa
    for group in numba.prange((S + LANES - 1) // LANES):
        lanes, path = segments_in_lanes(group * LANES, layout, chain), allocate_path(layout.steps)
        count, place = min(LANES, S - group * LANES), layout.first[lanes.s]
        nuisance, there = gather_nuisance(start, lanes), np.empty((knots, ALONG, LANES))
        linearise_segments(
            path, derivatives, there, nuisance, lanes, count, layout, chain, cars, widths, resolution, e[0], c
        )
        observe_means(out, place, path, count, lanes, layout, chain.h)
        for k in range(count):
            f, g = place[k], layout.first[lanes.s[k] + 1]
            along[lanes.s[k]] = there[:, :, k]
            apply_tracking(out[f:g, :, 0], e[0])
            if scale != 1.0:
                derivatives[f:g, :2] *= scale
            if not pulled:
                _rigid_sensitivities(derivatives[f:g], out[f:g, :, 0], nuisance[:N_POSE, k], scale)
    return out[:, :, 0].copy(), derivatives, along


def pose_sensitivities(
    layout: SegmentLayout, start: Floats, chain: ActuatorChain, p: Car, e: Switches, c: Constants
) -> Floats:
    """Derivatives (N, 3, N_NUISANCE) of predicted poses by initial states and pushes, by the variational equation.

    `start` (S, N_NUISANCE) holds each segment's initial state and pushes (constant disturbances over 0.25 s).
    Derivatives by the initial pose are exact (a rigid motion of the whole path) where no force varies with the pose.
    """
    return np.asarray(linearise_poses(layout, start, chain, np.array([p]), np.zeros(0), COARSE, e, c)[1])


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

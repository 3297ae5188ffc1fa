"""What any force on the body, and any turn of the wheel, does to predicted poses: linear in its history.

A segment is cut into knots of 0.125 s.  Its predicted poses answer to accelerations a_x, a_y, alpha_z of the body and
to a turn of the steered wheel in each knot by derivatives D.  A smooth law without a name has in each knot its value
there, so that the derivatives by any number of such laws are a product of D and their values.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.effects.remainder_table import (
    BODY_X,
    DIRECTION,
    DRIVEN_ALONG,
    FRONT_ACROSS,
    FRONT_ALONG,
    INPUTS,
    PHASE,
    REAR_ACROSS,
    ROLLING,
    ROLLING_V,
    WAVE,
    WHEEL_ANGLE,
    WORLD_X,
    WORLD_Y,
    YAW,
)
from bcid.likelihood.predict import FINE
from bcid.likelihood.step_matrix import N_PUSH
from bcid.likelihood.take import KNOTS
from bcid.physics.car import Car

HEADING = len(INPUTS)  # column of what the car is at, after INPUTS
ACTIONS = N_PUSH + FINE.turns  # a_x, a_y, alpha_z and a turn
HISTORY = ACTIONS * FINE.knots  # numbers in a segment's history
PUSHES = np.kron(np.eye(KNOTS), np.tile(np.eye(ACTIONS, N_PUSH), (FINE.knots // KNOTS, 1)))
"""Histories (HISTORY, 3 KNOTS) of the pushes, each of which lasts for several knots."""


class ForceHistory(NamedTuple):
    """Derivatives of predicted poses by what acts in each knot, and what the car is at there."""

    D: Floats  # (N, 3, HISTORY) knots in a row, ACTIONS of each
    along: Floats  # (S, knots, ALONG) INPUTS and the heading (rad)


def history_values(functions: Floats, along: Floats, car: Car) -> Floats:
    """What a unit of each of K `functions` (K, COLUMNS) of a remainder does in each knot: (S, HISTORY, K)."""
    acted = acting_values(functions, along, car)
    return np.asarray(acted.reshape(len(along), HISTORY, len(functions)))


def acting_values(functions: Floats, along: Floats, car: Car) -> Floats:
    """Accelerations and turn of the wheel (S, knots, ACTIONS, K) by a unit of each of K `functions` in each knot."""
    values = np.cos(along[:, :, :HEADING] @ functions[:, WAVE:].T + functions[:, PHASE])
    units = unit_actions(along, car)
    return np.asarray(values[:, :, None, :] * units[:, :, :, functions[:, DIRECTION].astype(int)])


def unit_actions(along: Floats, car: Car) -> Floats:
    """Accelerations of the body and turn of the wheel (S, knots, ACTIONS, 10) by a unit in each of the DIRECTIONS.

    `along` (S, knots, ALONG) is what the car is at.  The compiled car has the same in `unit_remainder`.  Where the car
    is heavier than its own mass, accelerations are of that: how much less it answers is in the derivatives by them.
    """
    delta, heading, v_x = along[:, :, INPUTS.index("delta")], along[:, :, HEADING], along[:, :, INPUTS.index("v_x")]
    cos_d, sin_d, cos_t, sin_t = np.cos(delta), np.sin(delta), np.cos(heading), np.sin(heading)
    ratio, f = car.m / car.I_z, car.front_share  # of an arm in m^2/s^2 to alpha_z
    units = np.zeros((*delta.shape, ACTIONS, WHEEL_ANGLE + 1))
    units[..., 0, BODY_X] = 1.0
    units[..., 0, FRONT_ALONG], units[..., 1, FRONT_ALONG] = cos_d, sin_d
    units[..., 2, FRONT_ALONG] = ratio * car.l_f * sin_d
    units[..., 0, FRONT_ACROSS], units[..., 1, FRONT_ACROSS] = -sin_d, cos_d
    units[..., 2, FRONT_ACROSS] = ratio * car.l_f * cos_d
    units[..., 1, REAR_ACROSS], units[..., 2, REAR_ACROSS] = 1.0, -ratio * car.l_r
    units[..., 2, YAW] = 1.0
    units[..., 0, WORLD_X], units[..., 1, WORLD_X] = cos_t, -sin_t
    units[..., 0, WORLD_Y], units[..., 1, WORLD_Y] = sin_t, cos_t
    units[..., 0, DRIVEN_ALONG], units[..., 1, DRIVEN_ALONG] = f * cos_d + 1.0 - f, f * sin_d
    units[..., 2, DRIVEN_ALONG] = f * ratio * car.l_f * sin_d
    units[..., 0, ROLLING] = np.tanh(v_x / ROLLING_V)
    units[..., N_PUSH, WHEEL_ANGLE] = 1.0
    return units


def answer_to(D: Floats, values: Floats, first: Ints) -> Floats:
    """Derivatives (N, 3, K) of predicted poses by K functions with the `values` (S, HISTORY, K) in each knot.

    Segment s has the rows `first[s]` to `first[s + 1]`.
    """
    out = np.empty((len(D), 3, values.shape[2]))
    if not values.shape[2]:
        return out
    for a, b, own in zip(first, first[1:], values, strict=False):
        np.matmul(D[a:b].reshape(-1, HISTORY), own, out=out[a:b].reshape(-1, values.shape[2]))
    return out

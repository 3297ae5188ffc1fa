"""Where the derivatives of an RK4 step stand: one flat array of vectors of LANES segments side by side.

`bcid.likelihood.variational` writes them stage by stage, `bcid.likelihood.step_matrix` reads them.  Rows of a state:
x, y, theta, v_x, v_y, omega, alpha_f, F_mf, F_mr.
"""

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.lane_access import load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import BodyState
from bcid.physics.car import Car

TWIST, LAG, N_STATE = 3, 6, 9  # where twist and lags begin in a state, and its size
# difference steps of a twist (m/s, rad/s) and of a pose (m, rad), of a lagging slip angle (rad) and force (N)
BODY_STEP, ANGLE_STEP, FORCE_STEP = 1e-5, 1e-5, 1e-2
TURN_STEP = 1e-7  # of the wheel's angle (rad): a wide one meets where a tyre saturates

# places in units of LANES numbers
ACCELERATION = 0  # (4, N_STATE, 3) at each stage, of v_x', v_y', omega' by the state, its lags as at the stage
STEADY = ACCELERATION + 4 * N_STATE * 3  # (4, LAG, 4) of alpha_f, F_mf, F_mr without lag, and v_fx, by pose and twist
COEFFICIENT = STEADY + 4 * LAG * 4  # (5, 3, 5) of each lag, at a stage or after the step, by what it follows from
POSE_RATE = COEFFICIENT + 5 * 3 * 5  # (4, 4) cos and sin of theta, x', y'
MASS_FACTOR = POSE_RATE + 4 * 4  # (4,)
SLOPE = MASS_FACTOR + 4  # (6, 5) of what has no name by pose and twist, at the present stage
CHANGE = SLOPE + 6 * 5  # (4, 1 + R, 6) at each stage, of accelerations and steady lags by a turn of the steered wheel,
# then by R parameters of a car


@njit_inline
def place_of_change(stage: int, row: int, parameters: int) -> int:
    """Where the changes at a `stage` by a turn (`row` 0) or by parameter number `row` of so many `parameters` begin."""
    return CHANGE + 6 * ((1 + parameters) * stage + row)


@njit_inline
def place_of_steady(stage: int, j: int) -> int:
    """Where the changes of steady lags and v_fx at a `stage` by component `j` (0 to 5) of pose and twist begin."""
    return STEADY + 4 * (LAG * stage + j)


@njit
def allocate_derivatives(parameters: int) -> Floats:
    """The flat array for a step's derivatives, of LANES segments, by so many `parameters` of a car: zeros."""
    return np.zeros(place_of_change(4, 0, parameters) * LANES)


@njit_inline
def get(x: Floats, i: int) -> float:
    """Vector number `i` of the flat array `x`."""
    vector: float = load_lanes(x, i * LANES)
    return vector


@njit_inline
def put(x: Floats, i: int, value: float) -> None:
    """Write `value` to vector number `i` of the flat array `x`."""
    store_lanes(value, x, i * LANES)


@njit_inline
def car_of_row(x: Floats) -> Car:
    """The car whose constants are the row `x` (22,), in the order of `Car`."""
    return Car(
        x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12], x[13], x[14], x[15], x[16],
        x[17], x[18], x[19], x[20], x[21],
    )  # fmt: skip


@njit_inline
def move_component(b: BodyState, j: int, by: float) -> BodyState:
    """The state `b` with its component `j` (0 to 5) greater by `by`; `b` itself for j < 0."""
    return BodyState(
        b.p_x + (by if j == 0 else 0.0), b.p_y + (by if j == 1 else 0.0), b.theta + (by if j == 2 else 0.0),
        b.v_x + (by if j == 3 else 0.0), b.v_y + (by if j == 4 else 0.0), b.omega + (by if j == 5 else 0.0),
    )  # fmt: skip

"""Sines and cosines of a remainder's functions, from those of a few angles.

Most functions are cosines of whole multiples of a few angles, half a wave of one quantity over its range each.  With
E = exp(i theta) of an angle, E^n = E^(n-1) E gives those of its multiples, and a product of up to FACTORS such powers
X + i Y the cosine and the sine of k . s: a few multiplications, where a cosine costs some thirty.  The function is then
c cos(k . s + phi) = C X + S Y.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints, Switches
from bcid.compiled.lane_access import get_like, put_like
from bcid.compiled.lanes import LANES, multiply_add
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.remainder_table import (
    COEFFICIENT,
    COLUMNS,
    DIRECTION,
    INPUTS,
    PHASE,
    ROOM,
    SETS,
    WAVE,
    RemainderInputs,
)
from bcid.physics.elementary import sincos

FACTORS = 3  # of a function: powers of as many angles
MOST_POWERS = 8  # of an angle
ALIKE = 1e-9  # multiples that are closer are the same

ON_COSINE, ON_SINE = COLUMNS, COLUMNS + 1
"""Columns of the switches' table of functions behind those of `remainder_table`: what a function is of X and of Y."""
PLANNED_COLUMNS = COLUMNS + 2
POWERS, INVERSE_POWERS, OFFSET, OWN_WAVE = 0, 1, 2, 3
"""Columns of a table of angles: how many powers are needed, and of exp(-i theta); theta is OFFSET + k . s, k from
OWN_WAVE on."""
ANGLE_COLUMNS, MOST_ANGLES = OWN_WAVE + len(INPUTS), SETS * len(INPUTS) + ROOM

NO_HALF_WAVES = np.zeros((len(INPUTS), 2))


class AnglePlan(NamedTuple):
    """The angles from which the K functions of a table are computed."""

    angles: Floats  # (A, ANGLE_COLUMNS)
    factors: Ints  # (K, 1 + FACTORS) how many powers are multiplied, and their numbers
    behind: Floats  # (K,) phase (rad) of the product, less that of the function
    order: Ints  # (K,) in which functions follow each other: those of one direction together


def plan_angles(functions: Floats, half_waves: Floats = NO_HALF_WAVES) -> AnglePlan:
    """The angles from which K `functions` (K, COLUMNS) are computed.

    `half_waves` (len(INPUTS), 2) are phase (rad) and wave number of the angle of each quantity; 0 where it has none.
    A function that is no whole multiple of these has an angle of its own, which others of the same waves share.
    """
    multiples, whole = _as_multiples(functions, half_waves)
    powers = np.max(multiples[whole], axis=0, initial=0)
    inverse = np.max(-multiples[whole], axis=0, initial=0)
    used = np.flatnonzero(powers + inverse)
    angles = np.zeros((len(used), ANGLE_COLUMNS))
    angles[:, POWERS], angles[:, INVERSE_POWERS], angles[:, OFFSET] = powers[used], inverse[used], half_waves[used, 0]
    angles[np.arange(len(used)), OWN_WAVE + used] = half_waves[used, 1]
    begin = np.cumsum(powers + inverse) - powers - inverse
    factors = np.zeros((len(functions), 1 + FACTORS), dtype=np.int64)
    behind = multiples @ half_waves[:, 0] - functions[:, PHASE]
    for j in np.flatnonzero(whole):
        q = np.flatnonzero(multiples[j])
        n = multiples[j, q]
        factors[j, 0], factors[j, 1 : 1 + len(q)] = len(q), begin[q] + np.where(n > 0, n - 1, powers[q] - n - 1)
    own, places = np.unique(functions[~whole, WAVE:], axis=0, return_inverse=True)
    factors[~whole, 0], factors[~whole, 1] = 1, int((powers + inverse).sum()) + places.ravel()
    behind[~whole] = -functions[~whole, PHASE]
    once = np.tile([1.0, 0.0, 0.0], (len(own), 1))
    order = np.argsort(functions[:, DIRECTION], kind="stable")
    return AnglePlan(np.concatenate([angles, np.column_stack([once, own])]), factors, behind, order)


def join_plans(functions: Floats, first: AnglePlan, second: AnglePlan) -> AnglePlan:
    """The plan of `functions` (K, COLUMNS) of which the first ones have the plan `first`, the others `second`."""
    behind = int(first.angles[:, [POWERS, INVERSE_POWERS]].sum())  # powers that come before those of the second
    later = second.factors.copy()
    later[:, 1:] += behind
    return AnglePlan(
        np.concatenate([first.angles, second.angles]), np.concatenate([first.factors, later]),
        np.r_[first.behind, second.behind], np.argsort(functions[:, DIRECTION], kind="stable"),
    )  # fmt: skip


def _as_multiples(functions: Floats, half_waves: Floats) -> tuple[Ints, Bools]:
    """Multiples (K, len(INPUTS)) of half waves that functions are, and whether they are (K,), of few and small ones."""
    k, wave = functions[:, WAVE:], half_waves[:, 1]
    n = np.divide(k, wave, out=np.where(k == 0.0, 0.0, np.nan), where=wave > 0.0)
    few = np.abs(n) < MOST_POWERS + 0.5
    multiples = np.round(np.where(few, n, 0.0)).astype(np.int64)
    whole = (few & (np.abs(n - multiples) < ALIKE)).all(axis=1)
    return multiples, whole & (np.count_nonzero(multiples, axis=1) <= FACTORS)


def planned_table(functions: Floats, plan: AnglePlan) -> Floats:
    """The switches' table (K, PLANNED_COLUMNS) of K `functions` (K, COLUMNS) with their coefficients, in order."""
    c = functions[:, COEFFICIENT]
    return np.column_stack([functions, c * np.cos(plan.behind), c * np.sin(plan.behind)])[plan.order]


@njit_inline
def _angle(e: Switches, i: int, s: RemainderInputs) -> float:
    """The angle (rad) number `i` of those in `e` at the inputs `s`."""
    k = e.angle
    angle: float = k[i, OFFSET] + k[i, OWN_WAVE] * s.v_x + k[i, OWN_WAVE + 1] * s.omega + k[i, OWN_WAVE + 2] * s.v_fx
    angle += k[i, OWN_WAVE + 3] * s.alpha_f + k[i, OWN_WAVE + 4] * s.alpha_r + k[i, OWN_WAVE + 5] * s.delta
    angle += k[i, OWN_WAVE + 6] * s.delta_rate + k[i, OWN_WAVE + 7] * s.u_m + k[i, OWN_WAVE + 8] * s.p_x
    angle += k[i, OWN_WAVE + 9] * s.p_y + k[i, OWN_WAVE + 10] * s.t
    return angle


@njit
def angle_powers(e: Switches, s: RemainderInputs) -> Floats:
    """Cosines and sines of all multiples of the angles in `e` at the inputs `s`: number 2 k and 2 k + 1 of power k."""
    powers, at = np.empty(2 * int(e.powers) * LANES), 0
    for i in range(int(e.angles)):
        sin_1, cos_1 = sincos(_angle(e, i, s))
        for part in range(2):
            cos_n, sin_n = cos_1, sin_1
            for _ in range(int(e.angle[i, part])):
                put_like(cos_n, powers, at)
                put_like(sin_n, powers, at + 1)
                cos_n, sin_n = _multiply(cos_n, sin_n, cos_1, sin_1)
                at += 2
            sin_1 = -sin_1
    return powers


@njit_inline
def _multiply(x: float, y: float, u: float, v: float) -> tuple[float, float]:
    """Real and imaginary part of (x + i y)(u + i v)."""
    return multiply_add(x, u, -(y * v)), multiply_add(x, v, y * u)


@njit_inline
def product_of_powers(e: Switches, j: int, powers: Floats, like: float) -> tuple[float, float]:
    """X and Y of function `j` of the remainder in `e`; `like` is a number of the kind that the `powers` are."""
    count, f = e.factor[j, 0], e.factor[j, 1]
    x, y = 0.0 * like + 1.0, 0.0 * like
    if count > 0:
        x, y = get_like(like, powers, 2 * f), get_like(like, powers, 2 * f + 1)
        for i in range(2, count + 1):
            f = e.factor[j, i]
            x, y = _multiply(x, y, get_like(like, powers, 2 * f), get_like(like, powers, 2 * f + 1))
    return x, y

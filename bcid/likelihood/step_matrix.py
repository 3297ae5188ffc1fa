"""The variational equation over one RK4 step: a matrix from what is before it, and in it, to the state after it.

Any number of changes of the state follow for a multiplication each.  What the columns of the matrix answer to, and how
accelerations change at each stage, is in `bcid.likelihood.variational`.
"""

from typing import NamedTuple

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import BodyState, LagState
from bcid.effects.motion import add_rates, stage_time, stage_weight
from bcid.likelihood.step_derivatives import (
    ACCELERATION,
    COEFFICIENT,
    LAG,
    MASS_FACTOR,
    N_STATE,
    POSE_RATE,
    TWIST,
    get,
    move_component,
    place_of_change,
    place_of_steady,
    put,
)

# columns after those of the state: three components of a push, a turn of the wheel, then parameters
N_PUSH, PUSH = 3, N_STATE
TURN = PUSH + N_PUSH
PARAMETER = TURN + 1


class SteadyChange(NamedTuple):
    """Changes of alpha_f, F_mf, F_mr as they would be without lag, and of v_fx."""

    alpha_f: float
    F_mf: float
    F_mr: float
    v_fx: float


@njit
def step_matrix(out: Floats, d: Floats, h: float, lagging: bool, pulled: bool, turns: int, parameters: int) -> None:
    """Write to `out` how the state after a step of `h` seconds answers each column: RK4, linearised.

    `out` is flat, (PARAMETER + R, N_STATE, LANES).  Columns are the state before the step, accelerations that act in it
    as the three components of a push, a turn of the wheel, and R `parameters`; `d` are the step's derivatives.  Columns
    of the pose are left out where nothing varies with it (not `pulled`), those of lags where nothing is `lagging`, and
    that of the turn where `turns` is 0.
    """
    for column in range(0 if pulled else TWIST, PARAMETER + parameters):
        if (lagging or not LAG <= column < PUSH) and (turns > 0 or column != TURN):
            _answer_to_column(out, column, d, h, lagging, pulled, parameters)


@njit
def _answer_to_column(
    out: Floats, column: int, d: Floats, h: float, lagging: bool, pulled: bool, parameters: int
) -> None:
    """Write to the flat `out` how the state after a step of `h` seconds answers a unit of `column` (`step_matrix`)."""
    none = 0.0 * get(d, MASS_FACTOR)
    rate = total = BodyState(none, none, none, none, none, none)
    begin = move_component(total, column, 1.0)
    lags = start = LagState(none, none, none)
    if lagging:
        start = _unit_lags(start, column - LAG)
    first = now = SteadyChange(none, none, none, none)
    for stage in range(4):
        x, at = add_rates(begin, rate, stage_time(stage) * h), ACCELERATION + stage * N_STATE * 3
        a_x = a_y = a_w = none
        own = place_of_change(stage, column - TURN, parameters) if column >= TURN else -1
        if own >= 0:
            a_x, a_y, a_w = get(d, own), get(d, own + 1), get(d, own + 2)
        elif column >= PUSH:
            pushed = 1.0 / get(d, MASS_FACTOR + stage)
            a_x = pushed if column == PUSH else none
            a_y = pushed if column == PUSH + 1 else none
            a_w = pushed if column == PUSH + 2 else none
        if pulled:
            a_x += get(d, at) * x.p_x + get(d, at + 3) * x.p_y + get(d, at + 6) * x.theta
            a_y += get(d, at + 1) * x.p_x + get(d, at + 4) * x.p_y + get(d, at + 7) * x.theta
            a_w += get(d, at + 2) * x.p_x + get(d, at + 5) * x.p_y + get(d, at + 8) * x.theta
        at += 3 * TWIST
        a_x += get(d, at) * x.v_x + get(d, at + 3) * x.v_y + get(d, at + 6) * x.omega
        a_y += get(d, at + 1) * x.v_x + get(d, at + 4) * x.v_y + get(d, at + 7) * x.omega
        a_w += get(d, at + 2) * x.v_x + get(d, at + 5) * x.v_y + get(d, at + 8) * x.omega
        if lagging:
            if stage != 2:
                now = _steady_change(d, place_of_steady(stage, 0), x, own, pulled)
                if stage == 0:
                    first = now
            lags = _lag_change(d, COEFFICIENT + 15 * stage, start, first, now)
            at += 3 * (LAG - TWIST)
            a_x += get(d, at) * lags.alpha_f + get(d, at + 3) * lags.F_mf + get(d, at + 6) * lags.F_mr
            a_y += get(d, at + 1) * lags.alpha_f + get(d, at + 4) * lags.F_mf + get(d, at + 7) * lags.F_mr
            a_w += get(d, at + 2) * lags.alpha_f + get(d, at + 5) * lags.F_mf + get(d, at + 8) * lags.F_mr
        at = POSE_RATE + 4 * stage
        cos_t, sin_t, v_x, v_y = get(d, at), get(d, at + 1), get(d, at + 2), get(d, at + 3)
        rate = BodyState(
            cos_t * x.v_x - sin_t * x.v_y - v_y * x.theta, sin_t * x.v_x + cos_t * x.v_y + v_x * x.theta, x.omega,
            a_x, a_y, a_w,
        )  # fmt: skip
        total = add_rates(total, rate, stage_weight(stage))
    if lagging:
        lags = _lag_change(d, COEFFICIENT + 4 * 15, start, first, now)
    put_state(out, column * N_STATE, add_rates(begin, total, h / 6.0), lags)


@njit_inline
def put_state(out: Floats, at: int, b: BodyState, lags: LagState) -> None:
    """Write a state, or a change of one, to N_STATE vectors of the flat array `out` from number `at` on."""
    put(out, at, b.p_x)
    put(out, at + 1, b.p_y)
    put(out, at + 2, b.theta)
    put(out, at + 3, b.v_x)
    put(out, at + 4, b.v_y)
    put(out, at + 5, b.omega)
    put(out, at + 6, lags.alpha_f)
    put(out, at + 7, lags.F_mf)
    put(out, at + 8, lags.F_mr)


@njit_inline
def _unit_lags(none: LagState, j: int) -> LagState:
    """The change of lags `none`, number `j` (0 to 2) greater by 1; as it is for other j."""
    return LagState(
        none.alpha_f + (1.0 if j == 0 else 0.0), none.F_mf + (1.0 if j == 1 else 0.0),
        none.F_mr + (1.0 if j == 2 else 0.0),
    )  # fmt: skip


@njit_inline
def _steady_change(d: Floats, at: int, x: BodyState, own: int, pulled: bool) -> SteadyChange:
    """Change of steady lags and v_fx with a change `x` of the state, and by what begins at `own` >= 0."""
    by_pose, at = at, at + 4 * TWIST
    alpha_f = get(d, at) * x.v_x + get(d, at + 4) * x.v_y + get(d, at + 8) * x.omega
    F_mf = get(d, at + 1) * x.v_x + get(d, at + 5) * x.v_y + get(d, at + 9) * x.omega
    F_mr = get(d, at + 2) * x.v_x + get(d, at + 6) * x.v_y + get(d, at + 10) * x.omega
    v_fx = get(d, at + 3) * x.v_x + get(d, at + 7) * x.v_y + get(d, at + 11) * x.omega
    if pulled:
        at = by_pose
        alpha_f += get(d, at) * x.p_x + get(d, at + 4) * x.p_y + get(d, at + 8) * x.theta
        F_mf += get(d, at + 1) * x.p_x + get(d, at + 5) * x.p_y + get(d, at + 9) * x.theta
        F_mr += get(d, at + 2) * x.p_x + get(d, at + 6) * x.p_y + get(d, at + 10) * x.theta
        v_fx += get(d, at + 3) * x.p_x + get(d, at + 7) * x.p_y + get(d, at + 11) * x.theta
    if own >= 0:
        alpha_f += get(d, own + 3)
        F_mf += get(d, own + 4)
        F_mr += get(d, own + 5)
    return SteadyChange(alpha_f, F_mf, F_mr, v_fx)


@njit_inline
def _lag_change(d: Floats, at: int, start: LagState, first: SteadyChange, now: SteadyChange) -> LagState:
    """Change of lagging quantities with those of their start, and of steady values as the step began and `now`."""
    return LagState(
        _follow(d, at, start.alpha_f, first.alpha_f, first.v_fx, now.alpha_f, now.v_fx),
        _follow(d, at + 5, start.F_mf, first.F_mf, first.v_fx, now.F_mf, now.v_fx),
        _follow(d, at + 10, start.F_mr, first.F_mr, first.v_fx, now.F_mr, now.v_fx),
    )


@njit_inline
def _follow(d: Floats, at: int, start: float, first: float, first_v: float, now: float, v: float) -> float:
    """Change of one lagging quantity by its five coefficients in `d`, from `at` on."""
    followed: float = get(d, at) * start + get(d, at + 1) * first + get(d, at + 2) * first_v
    return followed + get(d, at + 3) * now + get(d, at + 4) * v


@njit_inline
def advance_change(
    x: Floats, at: int, matrix: Floats, added: int, turned: tuple[float, float], lagging: bool, pulled: bool
) -> None:
    """Advance a change of the state, N_STATE vectors of `x` from number `at` on, by a step with its `matrix`, in place.

    The column `added` of the matrix is added, unless it is negative.  Where nothing varies with the pose (not
    `pulled`), a change of it moves the rest of the path as a rigid body, by the step's way in x and y, `turned`.
    """
    p_x, p_y, theta = get(x, at), get(x, at + 1), get(x, at + 2)
    v_x, v_y, omega = get(x, at + 3), get(x, at + 4), get(x, at + 5)
    alpha_f, F_mf, F_mr = get(x, at + 6), get(x, at + 7), get(x, at + 8)
    if not pulled:
        put(x, at, p_x - turned[1] * theta)
        put(x, at + 1, p_y + turned[0] * theta)
    for i in range(N_STATE if lagging else LAG):
        after = get(x, at + i) if i < TWIST and not pulled else 0.0 * p_x
        if pulled:
            after += get(matrix, i) * p_x + get(matrix, N_STATE + i) * p_y + get(matrix, 2 * N_STATE + i) * theta
        to = TWIST * N_STATE + i
        after += get(matrix, to) * v_x + get(matrix, to + N_STATE) * v_y + get(matrix, to + 2 * N_STATE) * omega
        if lagging:
            to = LAG * N_STATE + i
            after += get(matrix, to) * alpha_f + get(matrix, to + N_STATE) * F_mf + get(matrix, to + 2 * N_STATE) * F_mr
        if added >= 0:
            after += get(matrix, added * N_STATE + i)
        put(x, at + i, after)

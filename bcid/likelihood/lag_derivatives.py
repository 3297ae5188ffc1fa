"""How lagging quantities change with what they follow from: their start, and steady values at two instants."""

from bcid.aliases import Floats, Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import LagState, Wrench
from bcid.effects.motion import advance_lags, lags_at_stage
from bcid.likelihood.step_derivatives import ANGLE_STEP, BODY_STEP, FORCE_STEP, put


@njit_inline
def move_lag(lags: LagState, j: int) -> LagState:
    """The lagging quantities, number `j` (0 to 2) greater by its difference step; as they are for other j."""
    return LagState(
        lags.alpha_f + (ANGLE_STEP if j == 0 else 0.0), lags.F_mf + (FORCE_STEP if j == 1 else 0.0),
        lags.F_mr + (FORCE_STEP if j == 2 else 0.0),
    )  # fmt: skip


@njit_inline
def _move_lags(lags: LagState) -> LagState:
    """All lagging quantities, greater by their difference steps."""
    return LagState(lags.alpha_f + ANGLE_STEP, lags.F_mf + FORCE_STEP, lags.F_mr + FORCE_STEP)


@njit_inline
def _move_steady(w: Wrench, steady: bool, rolling: bool) -> Wrench:
    """The wrench `w` with its steady lags, or its rolling speed v_fx, greater by their difference steps."""
    to = _move_lags(w.steady)
    return Wrench(
        w.F_x, w.F_y, w.M_z, w.mass_factor,
        LagState(
            to.alpha_f if steady else w.steady.alpha_f, to.F_mf if steady else w.steady.F_mf,
            to.F_mr if steady else w.steady.F_mr,
        ),
        w.v_fx + (BODY_STEP if rolling else 0.0),
    )  # fmt: skip


@njit
def store_lag_coefficients(
    out: Floats, at: int, start: LagState, first: Wrench, now: Wrench, ahead: float, h: float, e: Switches
) -> None:
    """Write the derivatives of the three lagging quantities by what they follow from to `out` from `at` on.

    Those of a stage `ahead` seconds into a step of `h` seconds; for `ahead` > h, those after the step.  Each follows
    from its value `start` as the step begins, from its steady value and v_fx in the wrench `first`, and in `now`.
    """
    still = start
    for j in range(6):
        s = _move_lags(start) if j == 1 else start
        f, n = _move_steady(first, j == 2, j == 3), _move_steady(now, j == 4, j == 5)
        lags = advance_lags(s, f, n, h, e) if ahead > h else lags_at_stage(s, f, n, ahead, h, e)
        if j == 0:
            still = lags
        else:
            angle, force = (BODY_STEP, BODY_STEP) if j in (3, 5) else (ANGLE_STEP, FORCE_STEP)
            put(out, at + j - 1, (lags.alpha_f - still.alpha_f) / angle)
            put(out, at + 5 + j - 1, (lags.F_mf - still.F_mf) / force)
            put(out, at + 10 + j - 1, (lags.F_mr - still.F_mr) / force)


@njit_inline
def store_steady(out: Floats, at: int, moved: LagState, now: LagState, by: float) -> None:
    """Write derivatives of steady lags, by differences between `moved` and `now` over `by`, to `out` from `at` on."""
    put(out, at, (moved.alpha_f - now.alpha_f) / by)
    put(out, at + 1, (moved.F_mf - now.F_mf) / by)
    put(out, at + 2, (moved.F_mr - now.F_mr) / by)

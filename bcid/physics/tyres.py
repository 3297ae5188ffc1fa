"""Lateral tyre force: advanced slip ratio and the piecewise-linear law."""

from bcid.compiled.njit import njit_inline
from bcid.physics.elementary import arctan, clip


@njit_inline
def slip_angle(v_along: float, v_across: float, v_0: float) -> float:
    """Slip angle (rad) with the advanced slip ratio's bound `v_0` (m/s) on the rolling speed.

    Paper, App. slip; |v_along| lets a wheel roll backwards (errata 15), v_0 is errata 14's.
    """
    return arctan(v_across / max(abs(v_along), v_0))


@njit_inline
def lateral_force(alpha: float, C: float, F_max: float) -> float:
    """Lateral tyre force (N): -C alpha, limited to +-F_max (paper, latTireForce).

    `C` is the cornering stiffness (N/rad), `F_max` a force (errata 7).
    """
    return clip(-C * alpha, -F_max, F_max)

"""Lateral tyre force: advanced slip ratio and the piecewise-linear law."""

from bcid.compiled.njit import njit_inline
from bcid.physics.elementary import arctan_ratio, clip


@njit_inline
def slip_angle(v_along: float, v_across: float, v_0: float) -> float:
    """Slip angle (rad) of a wheel that rolls at v_along (m/s): atan(v_across/max(|v_along|, v_0)).

    `v_across` (m/s) is the velocity of its contact point across it, left positive; `v_0` (m/s) keeps the angle small
    near standstill; |v_along| lets a wheel roll backwards (paper, App. slip; docs/errata.md rows 14 and 15).
    """
    return arctan_ratio(v_across, max(abs(v_along), v_0))


@njit_inline
def lateral_force(alpha: float, C: float, F_max: float) -> float:
    """Lateral tyre force (N) at the slip angle `alpha` (rad): -C alpha, limited to +-F_max.

    `C` is the cornering stiffness (N/rad), `F_max` a force in N (paper, lateral tyre force; docs/errata.md row 7).
    """
    return clip(-C * alpha, -F_max, F_max)

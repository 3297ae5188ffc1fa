"""Lateral tyre force: advanced slip ratio and the piecewise-linear law."""

import math

from bcid.compiled.lanes import where
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
def slip_angle_slopes(v_along: float, v_across: float, v_0: float) -> tuple[float, float]:
    """Derivatives (s/m) of `slip_angle` by the velocities `v_along` and `v_across` (m/s) of a wheel's contact point."""
    speed = abs(v_along)
    fast = max(speed, v_0)
    per_square = 1.0 / (fast * fast + v_across * v_across)
    by_along = where(speed > v_0, -v_across * per_square * math.copysign(1.0, v_along), 0.0)
    return by_along, fast * per_square


@njit_inline
def lateral_force(alpha: float, C: float, F_max: float) -> float:
    """Lateral tyre force (N) at the slip angle `alpha` (rad): -C alpha, limited to +-F_max.

    `C` is the cornering stiffness (N/rad), `F_max` a force in N (paper, lateral tyre force; docs/errata.md row 7).
    """
    return clip(-C * alpha, -F_max, F_max)

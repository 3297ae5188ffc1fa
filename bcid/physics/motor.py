"""Motor and drag force along the driven wheel."""

from bcid.compiled.lanes import where
from bcid.compiled.njit import njit_inline
from bcid.physics.elementary import clip


@njit_inline
def speed_controlled_force(u_m: float, v_w: float, K_t: float, K_b: float, F_max: float) -> float:
    """Motor force (N) of the proportional speed controller (paper, App. actuators, errata 13).

    `u_m` >= 0 is a reference speed (m/s): the motor only supplies, clip(K_t (u_m - v_w), 0, F_max).
    `u_m` < 0 is a brake share: clip(u_m K_b v_w, -F_max, F_max).
    """
    supplied = clip(K_t * (u_m - v_w), 0.0, F_max)
    braked = clip(u_m * K_b * v_w, -F_max, F_max)
    return where(u_m >= 0.0, supplied, braked)


@njit_inline
def force_controlled_force(u_m: float, v_w: float, K: float, u_0: float, K_v: float, K_b: float, F_max: float) -> float:
    """Motor force (N) of a throttle that sets a force: K (u_m - u_0) - K_v v_w above u_0, else none.

    Braking and the limit F_max are those of the speed-controlled motor.
    """
    supplied = clip(K * (u_m - u_0) - K_v * v_w, -F_max, F_max)
    braked = clip(min(u_m, 0.0) * K_b * v_w, -F_max, F_max)
    return where(u_m > u_0, supplied, braked)


@njit_inline
def drag_force(v_w: float, R_1: float, R_2: float) -> float:
    """Drag force (N) against rolling at the speed v_w (m/s): R_1 v_w + R_2 v_w |v_w|, odd in v_w (errata 6)."""
    return R_1 * v_w + R_2 * v_w * abs(v_w)

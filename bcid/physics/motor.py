"""Motor and drag force along the driven wheel."""

from bcid.compiled.lanes import where
from bcid.compiled.njit import njit_inline
from bcid.physics.elementary import clip


@njit_inline
def speed_controlled_force(u_m: float, v_w: float, K_t: float, K_b: float, F_max: float) -> float:
    """Motor force (N) of a proportional speed controller at the wheel speed `v_w` (m/s).

    `u_m` >= 0 is a reference speed (m/s): the motor only supplies, clip(K_t (u_m - v_w), 0, F_max).  `u_m` < 0 is a
    brake share: clip(u_m K_b v_w, -F_max, F_max) (paper, App. actuators; docs/errata.md row 13).
    """
    supplied = clip(K_t * (u_m - v_w), 0.0, F_max)
    braked = clip(u_m * K_b * v_w, -F_max, F_max)
    return where(u_m >= 0.0, supplied, braked)


@njit_inline
def force_controlled_force(u_m: float, v_w: float, K: float, u_0: float, K_v: float, K_b: float, F_max: float) -> float:
    """Motor force (N) at the wheel speed `v_w` (m/s) where the throttle sets a force: K (u_m - u_0) - K_v v_w.

    That holds for a throttle `u_m` above its dead zone u_0; from 0 to u_0 there is no force, and u_m < 0 is a brake
    share, u_m K_b v_w.  All is limited to +-F_max.
    """
    supplied = clip(K * (u_m - u_0) - K_v * v_w, -F_max, F_max)
    braked = clip(min(u_m, 0.0) * K_b * v_w, -F_max, F_max)
    return where(u_m > u_0, supplied, braked)


@njit_inline
def drag_force(v_w: float, R_1: float, R_2: float) -> float:
    """Drag force R_1 v_w + R_2 v_w |v_w| (N) against rolling at v_w (m/s) (paper, F_d; docs/errata.md row 6)."""
    return R_1 * v_w + R_2 * v_w * abs(v_w)

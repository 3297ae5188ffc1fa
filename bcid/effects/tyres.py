"""How the tyres' side force differs from the base model's piecewise-linear law, and the floor under them."""

import math

from bcid.compiled.lanes import where
from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter
from bcid.effects.forces import PLACE, RADIUS, is_in_circle
from bcid.effects.lags import first_order_lag
from bcid.physics.elementary import sincos


@njit
def tyre_relaxation(alpha: float, steady_0: float, steady_1: float, rolled: float, sigma: float) -> float:
    """Front slip angle (rad) after `rolled` metres of tyre relaxation, alpha' = |v_fx| (alpha_s - alpha)/sigma.

    The steady slip angle alpha_s runs linearly from steady_0 to steady_1 over that way; sigma (m) is the relaxation
    length.
    """
    return first_order_lag(alpha, steady_0, steady_1, rolled / sigma) if sigma > 0.0 else steady_1


@njit
def friction_circle(F_max: float, F_m: float, kappa: float) -> float:
    """Side force (N) left to a tyre by the motor force F_m (N): F_max sqrt(1 - kappa (F_m/F_max)^2), at least 0."""
    if kappa == 0.0:
        return F_max
    share = F_m / where(F_max > 0.0, F_max, 1.0)
    return where(F_max > 0.0, F_max * math.sqrt(max(1.0 - kappa * share * share, 0.0)), F_max)


@njit
def tyre_soft_saturation(linear: float, F_max: float, s: float) -> float:
    """Side force of a tyre (N): (1 - s) clip(linear, +-F_max) + s F_max tanh(linear/F_max), s from 0 (clipped) to 1.

    `linear` (N) is the force without a limit: -C alpha, and what is added to it before saturation.
    """
    clipped = min(max(linear, -F_max), F_max)
    if s == 0.0:
        return clipped
    none = F_max <= 0.0
    soft = F_max * math.tanh(linear / where(none, 1.0, F_max))
    return where(none, clipped, (1.0 - s) * clipped + s * soft)


@njit
def load_transfer(F_l: float, delta_w: float, F_lr: float, m: float, k: float) -> float:
    """Factor 1 - k a_x of the front tyre's stiffness and largest side force, unloaded by the forward acceleration a_x.

    a_x = (F_l cos(delta_w) + F_lr)/m (m/s^2) from the drive forces (N) along the front wheel, at the angle delta_w
    (rad), and of the rear axle, for the mass m (kg).
    """
    return 1.0 - k * (F_l * sincos(delta_w)[1] + F_lr) / m if k != 0.0 else 1.0


@njit
def front_ply_steer(v_fx: float, f: float, v_c: float) -> float:
    """Side force f tanh(v_fx/v_c) (N), added before saturation, of a front tyre rolling without slip at v_fx (m/s)."""
    return f * math.tanh(v_fx / v_c) if f != 0.0 else 0.0


@njit
def rear_toe(v_x: float, epsilon: float, v_0: float) -> float:
    """Slip angle -epsilon v_x/max(|v_x|, v_0) (rad) to be added at rear wheels that point aside by epsilon (rad).

    `v_0` is the least rolling speed (m/s) in slip angles.
    """
    return -epsilon * v_x / max(abs(v_x), v_0) if epsilon != 0.0 else 0.0


@njit
def slippery_patch(p_x: float, p_y: float, D: float, x: float, y: float, radius: float) -> float:
    """Factor of both axles' largest side force: 1 - D while the CoG is on a slippery circle of the floor, else 1.

    The CoG is at (p_x, p_y), the circle has the centre (x, y) and the `radius`, all in m.
    """
    return where(is_in_circle(p_x, p_y, x, y, radius), 1.0 - D, 1.0) if D != 0.0 else 1.0


EFFECTS = (
    Effect(
        tyre_relaxation, "front slip lags: α̇ = abs(v_fx)(α_s − α)/σ",
        (Parameter("sigma", "m", 0.0, 2.0, 0.045, "relaxation length"),),
        "fy", looks_like=("steering_delay", "steering_lag"), depends_on=("steering_rate", "alpha_f"),
        source="first-order lag in rolled distance; Pacejka (2012), ch. 7",
    ),
    Effect(
        friction_circle, "F̂_f → F̂_f·√(1 − κ(F_m/F̂_f)²)",
        (Parameter("kappa", "1", 0.0, 4.0, 1.9, "share of the grip that the motor force takes"),),
        "fy", looks_like=("load_transfer",), depends_on=("throttle", "alpha_f"),
        source="combined slip by the friction ellipse; Pacejka (2012), ch. 3",
    ),
    Effect(
        tyre_soft_saturation, "blend s of clip with F̂·tanh(Cα/F̂), front and rear",
        (Parameter("s", "1", 0.0, 1.0, 0.8, "softness"),), "fy", depends_on=("alpha_f", "alpha_r"),
        source="a smooth saturating side force in place of a clipped line; Pacejka (2012), ch. 3",
    ),
    Effect(
        load_transfer, "C_f, F̂_f × (1 − k·a_x), a_x = (F_m − F_d) cos δ_w/m",
        (Parameter("k", "m^-1 s^2", -1.0, 1.0, 0.13, "unloading of the front axle per acceleration"),),
        "fy", looks_like=("friction_circle",), depends_on=("throttle", "alpha_f"),
        source="axle load under acceleration; Gillespie (1992), ch. 1, with force in proportion to load",
    ),
    Effect(
        front_ply_steer, "F_αf += f·tanh(v_fx/0.05), before saturation",
        (Parameter("f", "kg m s^-2", -500.0, 500.0, 18.0, "side force of a rolling wheel without slip"),),
        "fy", looks_like=("steering_offset",), depends_on=("v_x",),
        source="ply steer and conicity: side force without slip; Pacejka (2012), ch. 4",
    ),
    Effect(
        rear_toe, "α_r −= ε·v_x/max(abs(v_x), v_0)",
        (Parameter("epsilon", "rad", -0.2, 0.2, 0.01, "thrust angle of both rear wheels"),),
        "fy", looks_like=("body_yaw_misalignment",), depends_on=("v_x",),
        source="both rear wheels pointing aside: a thrust angle",
    ),
    Effect(
        slippery_patch, "F̂_f, F̂_r × (1 − D) while the CoG is in the circle",
        (Parameter("D", "1", 0.0, 0.95, 0.3, "share of the grip that is missing"), *PLACE, RADIUS),
        "fy", "environment", depends_on=("place", "alpha_f"),
        source="less friction of another floor covering, within a circle",
    ),
)  # fmt: skip

"""How the angle at the wheel differs from what the base model's servo gives."""

import math

from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter
from bcid.effects.lags import first_order_lag


@njit
def steering_offset(delta: float, o: float) -> float:
    """Wheel angle delta + o (rad): a servo horn that is mounted at a wrong angle o (rad)."""
    return delta + o


@njit
def steering_backlash(delta_w: float, delta: float, b: float) -> float:
    """Wheel angle (rad) that follows delta with a play of +-b: it stays at delta_w until the play is used up."""
    return min(max(delta_w, delta - b), delta + b) if b > 0.0 else delta


@njit
def steering_dead_band(delta: float, after: float, u_s: float, b: float) -> float:
    """Servo angle (rad) at the end of a step in which a servo without a dead band would turn from delta to `after`.

    The servo does not move while its command u_s (rad) is within the half width b (rad) of delta, and stops as soon
    as its angle is within b of the command.
    """
    if b == 0.0:
        return after
    miss = u_s - delta
    if abs(miss) <= b:
        return delta
    return u_s - math.copysign(b, miss) if abs(u_s - after) < b else after


@njit
def steering_delay(time: float, tau: float) -> float:
    """Time + tau (s): when a steering command acts that was given at `time` (s)."""
    return time + tau


@njit
def steering_lag(delta_w: float, delta_0: float, delta_1: float, h: float, tau: float) -> float:
    """Wheel angle (rad) after `h` seconds of tau delta_w' = delta - delta_w, delta linear from delta_0 to delta_1."""
    return first_order_lag(delta_w, delta_0, delta_1, h / tau) if tau > 0.0 else delta_1


@njit
def steering_nonlinearity(delta: float, k: float) -> float:
    """Wheel angle delta + k delta^3 (rad): the first odd term of the linkage."""
    return delta + k * delta * delta * delta


@njit
def steering_side_gain(delta: float, a: float) -> float:
    """Wheel angle delta (1 + a sign(delta)) (rad): the linkage turns farther to the left where a > 0."""
    return delta * (1.0 + a * math.copysign(1.0, delta)) if a != 0.0 else delta


@njit
def steering_speed_gain(delta: float, v_x: float, v_y: float, k: float) -> float:
    """Wheel angle delta (1 - k |V|) (rad): steering that gives way with the speed |V| of (v_x, v_y) (m/s), k in s/m."""
    return delta * (1.0 - k * math.hypot(v_x, v_y)) if k != 0.0 else delta


@njit
def steering_rate_asymmetry(d: float, miss: float, a: float) -> float:
    """Rate limit of the servo (rad/s): d (1 + a) while it turns left, d (1 - a) while it turns right.

    `miss` = u_s - delta (rad) is the command minus the angle; the servo turns left where it is positive.
    """
    return d * (1.0 + a) if miss > 0.0 else d * (1.0 - a)


@njit
def steering_compliance(delta_w: float, delta: float, F_af: float, k: float) -> float:
    """Residual delta_w - delta - k F_af (rad): 0 where the linkage gives way by k (rad/N) times the side force (N)."""
    return delta_w - delta - k * F_af


EFFECTS = (
    Effect(
        steering_offset, "δ_w = δ + o", (Parameter("o", "rad", -0.3, 0.3, 0.008, "offset"),),
        "steering", looks_like=("front_ply_steer", "body_yaw_misalignment"), depends_on=("v_x",),
        source="misaligned servo horn: a constant angle",
    ),
    Effect(
        steering_backlash, "δ_w follows δ with play ±b", (Parameter("b", "rad", 0.0, 0.3, 0.018, "half the play"),),
        "steering", looks_like=("steering_dead_band",), depends_on=("steering_rate",),
        source="play (hysteresis) operator; Visintin (1994), ch. III",
    ),
    Effect(
        steering_dead_band, "the servo rests while abs(u_s − δ) < b",
        (Parameter("b", "rad", 0.0, 0.3, 0.045, "half width"),), "steering", looks_like=("steering_backlash",),
        depends_on=("steering_rate",), source="dead band of a position servo",
    ),
    Effect(
        steering_delay, "u_s(t − τ)", (Parameter("tau", "s", 0.0, 0.5, 0.013, "delay"),),
        "steering", looks_like=("pose_latency", "tyre_relaxation"), depends_on=("steering_rate",),
        source="transport delay of the command",
    ),
    Effect(
        steering_lag, "δ_w follows δ with a further first-order lag τ",
        (Parameter("tau", "s", 0.0, 1.0, 0.014, "time constant"),), "steering", looks_like=("steering_delay",),
        depends_on=("steering_rate",), source="first-order lag of the linkage",
    ),
    Effect(
        steering_nonlinearity, "δ_w = δ + k·δ³", (Parameter("k", "rad^-2", -0.5, 0.5, 0.008, "cubic part"),),
        "steering", looks_like=("steering_speed_gain",), depends_on=("steering",),
        source="first odd term of a linkage's angle ratio",
    ),
    Effect(
        steering_side_gain, "δ_w = δ(1 + a·sign δ)", (Parameter("a", "1", -0.5, 0.5, 0.013, "excess to the left"),),
        "steering", looks_like=("steering_offset",), depends_on=("steering",),
        source="unequal linkage ratios to the left and to the right",
    ),
    Effect(
        steering_speed_gain, "δ_w = δ(1 − k·abs(V))", (Parameter("k", "m^-1 s", -0.5, 0.5, 0.028, "loss per speed"),),
        "steering", looks_like=("steering_nonlinearity",), depends_on=("steering", "speed"),
        source="steering that gives way with speed; linear",
    ),
    Effect(
        steering_rate_asymmetry, "rate limits d(1 + a) to the left, d(1 − a) to the right",
        (Parameter("a", "1", -0.9, 0.9, 0.011, "excess to the left"),), "steering", looks_like=("steering_offset",),
        depends_on=("steering_rate",), source="a servo faster to one side",
    ),
    Effect(
        steering_compliance, "δ_w = δ + k·F_αf(δ_w), solved together",
        (Parameter("k", "kg^-1 m^-1 s^2 rad", -5e-4, 5e-4, 9e-5, "angle per side force"),),
        "steering", depends_on=("alpha_f",),
        source="compliance under the side force's moment about the kingpin; Pacejka (2012), ch. 1",
    ),
)  # fmt: skip

"""How the angle at the wheel differs from what the base model's servo gives."""

from __future__ import annotations

import math

from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter


@njit
def play(behind: float, delta: float, b: float) -> float:
    """The angle that follows delta with play of +-b, last at `behind`."""
    return min(max(behind, delta - b), delta + b)


@njit
def linkage(delta: float, speed: float, k3: float, side: float, k_v: float, offset: float) -> float:
    """Delta + k delta^3, times (1 + a sign), times (1 - k |V|), plus o."""
    angle = delta + k3 * delta * delta * delta
    if side != 0.0:
        angle *= 1.0 + side * math.copysign(1.0, angle)
    return angle * (1.0 - k_v * speed) + offset


def _steering(
    id: str, equation: str, parameter: Parameter, *twins: str, depends: tuple[str, ...], source: str  # noqa: A002
) -> Effect:  # fmt: skip
    return Effect(id, equation, (parameter,), "steering", "vehicle", twins, depends, source=source)


EFFECTS = (
    _steering(
        "steering_offset", "δ_w = δ + o", Parameter("o", "rad", -0.3, 0.3, 0.008, "offset"),
        "front_ply_steer", "body_yaw_misalignment", depends=("v_x",),
        source="misaligned servo horn: a constant angle",
    ),
    _steering(
        "steering_backlash", "δ_w follows δ with play ±b", Parameter("b", "rad", 0.0, 0.3, 0.018, "half the play"),
        "steering_dead_band", depends=("steering_rate",),
        source="play (hysteresis) operator; Visintin (1994), ch. III",
    ),
    _steering(
        "steering_dead_band", "the servo rests while abs(u_s − δ) < b",
        Parameter("b", "rad", 0.0, 0.3, 0.045, "half width"), "steering_backlash", depends=("steering_rate",),
        source="dead band of a position servo",
    ),
    _steering(
        "steering_delay", "u_s(t − τ)", Parameter("tau", "s", 0.0, 0.5, 0.013, "delay"),
        "pose_latency", "tyre_relaxation", depends=("steering_rate",),
        source="transport delay of the command",
    ),
    _steering(
        "steering_lag", "δ_w follows δ with a further first-order lag τ",
        Parameter("tau", "s", 0.0, 1.0, 0.014, "time constant"), "steering_delay", depends=("steering_rate",),
        source="first-order lag of the linkage",
    ),
    _steering(
        "steering_nonlinearity", "δ_w = δ + k·δ³", Parameter("k", "rad^-2", -0.5, 0.5, 0.008, "cubic part"),
        "steering_speed_gain", depends=("steering",),
        source="first odd term of a linkage's angle ratio",
    ),
    _steering(
        "steering_side_gain", "δ_w = δ(1 + a·sign δ)", Parameter("a", "1", -0.5, 0.5, 0.013, "excess to the left"),
        "steering_offset", depends=("steering",),
        source="unequal linkage ratios to the left and to the right",
    ),
    _steering(
        "steering_speed_gain", "δ_w = δ(1 − k·abs(V))", Parameter("k", "m^-1 s", -0.5, 0.5, 0.028, "loss per speed"),
        "steering_nonlinearity", depends=("steering", "speed"),
        source="steering that gives way with speed; linear",
    ),
    _steering(
        "steering_rate_asymmetry", "rate limits d(1 + a) to the left, d(1 − a) to the right",
        Parameter("a", "1", -0.9, 0.9, 0.011, "excess to the left"), "steering_offset", depends=("steering_rate",),
        source="a servo faster to one side",
    ),
    _steering(
        "steering_compliance", "δ_w = δ + k·F_αf(δ_w), solved together",
        Parameter("k", "kg^-1 m^-1 s^2 rad", -5e-4, 5e-4, 9e-5, "angle per side force"), depends=("alpha_f",),
        source="compliance under the side force's moment about the kingpin; Pacejka (2012), ch. 1",
    ),
)  # fmt: skip

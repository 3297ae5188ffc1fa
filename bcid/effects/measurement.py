"""How the recorded pose differs from the car's; and the car's mass, which may change on the way."""

from __future__ import annotations

import math

from bcid.compiled.lanes import where
from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter


@njit
def seen_pose(
    p_x: float, p_y: float, theta: float, d_x: float, d_y: float, psi: float, kappa: float
) -> tuple[float, float, float]:
    """The tracked pose: the point (d_x, d_y) from the CoG, positions times (1 + kappa), yaw plus psi."""
    cos_t, sin_t = math.cos(theta), math.sin(theta)
    x = p_x + cos_t * d_x - sin_t * d_y
    y = p_y + sin_t * d_x + cos_t * d_y
    return x + kappa * x, y + kappa * y, theta + psi


@njit
def heavier(t: float, d: float, t_s: float) -> float:
    """M and I_z times (1 + d) from t_s on."""
    return where(t >= t_s, 1.0 + d, 1.0) if d != 0.0 else 1.0


_HELD = "the vehicle file's lengths"

EFFECTS = (
    Effect(
        "mass_change", "m, I_z × (1 + d) from t_s on",
        (
            Parameter("d", "1", -0.5, 3.0, 0.1, "relative change"),  # a load is seldom more than the car
            Parameter("t_s", "s", 0.0, 1e5, 0.0, "when", places=True),
        ),
        "any", looks_like=("motor_sag",), depends_on=("time",),
        source="added load: m and I_z in proportion",
    ),
    Effect(
        "pose_latency", "pose arrives τ late against the commands",
        (Parameter("tau", "s", -0.3, 0.3, 0.011, "latency"),),
        "time", "measurement", ("steering_delay",), ("steering_rate", "throttle"),
        source="delay of the tracking system against the command clock",
    ),
    Effect(
        "clock_drift", "the pose clock runs (1 + ρ) times the command clock",
        (Parameter("rho", "1", -1e-3, 1e-3, 3.5e-5, "drift"),),
        "time", "measurement", ("pose_latency",), ("time", "steering_rate"),
        source="two clocks at a constant rate ratio",
    ),
    Effect(
        "marker_offset", "tracked point at (d_x, d_y) from the CoG",
        (  # markers stand on the car: none is farther than half a wheelbase or so
            Parameter("d_x", "m", -0.5, 0.5, 0.02, "ahead"),
            Parameter("d_y", "m", -0.5, 0.5, 0.02, "to the left"),
        ),
        "pose", "measurement", ("yaw_scrub",), ("yaw_rate",), _HELD,
        source="rigid-body kinematics: the tracked point is not the CoG",
    ),
    Effect(
        "body_yaw_misalignment", "tracked yaw = θ + ψ", (Parameter("psi", "rad", -0.5, 0.5, 0.014, "angle"),),
        "pose", "measurement", ("steering_offset",), ("v_x",),
        source="the tracked body's x axis is not the car's",
    ),
    Effect(
        "pose_scale", "tracked positions × (1 + κ)", (Parameter("kappa", "1", -0.5, 0.5, 0.06, "excess"),),
        "pose", "measurement", depends_on=("speed",), held=_HELD,
        source="wrong length scale of the tracking calibration",
    ),
)  # fmt: skip

"""What a base model may have wrong that no effect of the vocabulary describes: its own simplifications.

A diagnosis fits these beside the vocabulary.  They are never named as missing physics: they must lose against
an effect that is there, and take up what would otherwise be mistaken for one.
"""

from bcid.aliases import Floats
from bcid.compiled.lanes import where
from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter


@njit
def tyre_fall(linear: float, F_max: float, f: float) -> float:
    """Largest side force (N) of a tyre whose grip falls past saturation: F_max (1 - f o/(1 + o)).

    o = max(|linear|/F_max - 1, 0) is the relative excess over F_max of `linear` (N), the side force without a limit;
    f is the share of F_max that is lost at very large slip.
    """
    if f == 0.0:
        return F_max
    over = max(abs(linear) / where(F_max > 0.0, F_max, 1.0) - 1.0, 0.0)
    return where(F_max > 0.0, F_max * (1.0 - f * over / (1.0 + over)), F_max)


@njit
def slip_speed(v_0: float, d: float) -> float:
    """Speed v_0 (1 + d) (m/s): lower limit v_0 of |v_x| in the slip angle atan(v_y/max(|v_x|, v_0)), changed by d."""
    return v_0 * (1.0 + d)


@njit
def two_rear_wheels(v_x: float, omega: float, t: float, side: float) -> float:
    """Speed along the car v_x - side t omega (m/s) of a rear wheel, `side` = 1/2 (left) or -1/2 of the track t (m)."""
    return v_x - side * t * omega


@njit
def steering_scale(delta: float, g: float) -> float:
    """Steering angle (1 + g) delta (rad), where the vehicle file's gain from raw commands to rad is off by g."""
    return (1.0 + g) * delta


@njit
def motor_fade(F: float, u_m: float, v_w: float, u_0: float, k: float) -> float:
    """Motor force F - k (u_m - u_0) v_w (N) at a throttle u_m above its dead zone u_0; F itself at or below it.

    `v_w` is the wheel speed (m/s).  A pulsed bridge conducts for a share of the time that grows with the throttle,
    and only then does the motor's back EMF, which is proportional to the speed, reduce the current.
    """
    return where(u_m > u_0, F - k * (u_m - u_0) * v_w, F) if k != 0.0 else F


@njit
def throttle_timing(times: Floats, tau: float) -> Floats:
    """Times t + tau (n,) (s) at which a wheel had the speeds that its encoder's log has at the times t (n,).

    Encoders count over a while and loggers write when they are asked, so that tau may have either sign.
    """
    return times + tau


RAW_COMMANDS = ("steering_scale",)
"""Corrections of a vehicle whose commands come in units of their own, by gains that are known roughly."""

MEASURED_SPEED = ("throttle_timing",)
"""Corrections of a vehicle whose throttle is its driven wheel's measured speed, by a clock that is known roughly."""

CORRECTIONS: dict[str, Effect] = {
    e.id: e
    for e in (
        Effect(
            tyre_fall, "tyres' grip falls towards (1 − f)·F̂ past saturation",
            (Parameter("f", "1", 0.0, 0.9, 0.3, "share of the grip lost far past saturation"),),
            "fy", depends_on=("alpha_f", "alpha_r"),
            source="side force that falls past its peak; Pacejka (2012), ch. 1",
        ),
        Effect(
            slip_speed, "v_0 → v_0·(1 + d) in the slip angles",
            (Parameter("d", "1", -0.8, 3.0, 0.2, "relative change of the speed below which slip fades"),),
            "fy", depends_on=("v_x", "alpha_f", "alpha_r"),
            source="the paper's bound on the slip ratio's rolling speed (App. slip, errata 14), refitted",
        ),
        Effect(
            two_rear_wheels, "the rear axle's side force as that of two wheels, t apart",
            (Parameter("t", "m", 0.0, 1.3, 0.5, "track of the rear wheels"),),  # at most one and a half wheelbases
            "fy", depends_on=("alpha_r", "yaw_rate"),
            source="slip angle of each rear wheel at its own place; rigid-body kinematics",
        ),
        Effect(
            steering_scale, "δ → (1 + g)·δ, from raw steering commands",
            (Parameter("g", "1", -0.5, 1.0, 0.05, "relative error of the gain in the vehicle file"),),
            "steering", depends_on=("steering",), source="the vehicle file's gain from raw units to rad, refitted",
        ),
        Effect(
            motor_fade, "throttle force − k·(u − u_0)·v_w, where a throttle sets force",
            (Parameter("k", "kg s^-1", 0.0, 5000.0, 100.0, "how far a full throttle's force falls with speed"),),
            "motor", depends_on=("throttle", "v_x"),
            source="mean current of a pulsed bridge: on-time (V − k_e ω)/R; Mohan, Undeland, Robbins (2003), ch. 13",
        ),
        Effect(
            throttle_timing, "u_m(t − τ), where the throttle is a measured wheel speed",
            (Parameter("tau", "s", -0.05, 0.05, 0.01, "how late the wheel's speed is logged too early"),),
            "motor", depends_on=("throttle",),
            source="an encoder counts over a window, a logger writes when it is asked: a few hundredths of a second",
        ),
    )
}  # fmt: skip

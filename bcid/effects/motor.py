"""How the motor's force differs from the base model's law."""

from bcid.aliases import Floats
from bcid.compiled.lanes import where
from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter
from bcid.effects.lags import first_order_lag


@njit
def motor_delay(times: Floats, tau: float) -> Floats:
    """Times t + tau (n,) (s) at which throttle commands act that were given at the times t (n,)."""
    return times + tau


@njit
def motor_lag(F_m: float, steady_0: float, steady_1: float, h: float, tau: float) -> float:
    """Motor force (N) after `h` seconds of F_m' = (F_cmd - F_m)/tau, F_cmd linear from steady_0 to steady_1."""
    return first_order_lag(F_m, steady_0, steady_1, h / tau) if tau > 0.0 else steady_1


@njit
def motor_dead_zone(u_m: float, w: float) -> float:
    """Throttle max(u_m - w, 0): a reference speed (m/s) less the dead zone's width w; a brake share u_m < 0 stays."""
    return where(u_m < 0.0, u_m, max(u_m - w, 0.0)) if w != 0.0 else u_m


@njit
def motor_sag(F: float, t: float, T: float, s: float) -> float:
    """Motor force F (1 - s t/T) (N) at t (s) of a recording of T (s), at whose end a battery has lost the share s.

    Beyond the end, of which the recording tells nothing, the share stays s.
    """
    return F * (1.0 - s * min(t / T, 1.0))


@njit
def motor_power_limit(F: float, v_w: float, inverse_P: float, v_p: float) -> float:
    """Motor force F (N), but at most P/max(|v_w|, v_p), the power limit P (W) at the wheel speed v_w (m/s).

    inverse_P = 1/P (1/W) is 0 for no limit; `v_p` (m/s) keeps the limit finite at standstill.
    """
    return F if inverse_P == 0.0 else min(F, 1.0 / (inverse_P * max(abs(v_w), v_p)))


@njit
def motor_regeneration(u_m: float, v_w: float, K_t: float, F_max: float, r: float) -> float:
    """Braking force max(r K_t (u_m - v_w), -F_max) (N) of a wheel faster than its reference speed u_m (m/s), else 0.

    `r` is the share of the controller's gain K_t (N s/m) with which it brakes; 0 too where u_m < 0 is a brake share.
    """
    if r == 0.0:
        return 0.0
    return where((u_m < 0.0) | (v_w <= u_m), 0.0, max(r * K_t * (u_m - v_w), -F_max))


EFFECTS = (
    Effect(
        motor_delay, "u_m(t − τ)", (Parameter("tau", "s", 0.0, 0.5, 0.065, "delay"),),
        "motor", looks_like=("motor_lag",), depends_on=("throttle",), source="transport delay of the command",
    ),
    Effect(
        motor_lag, "Ḟ_m = (F_cmd − F_m)/τ", (Parameter("tau", "s", 0.0, 1.0, 0.06, "time constant"),),
        "motor", looks_like=("motor_delay",), depends_on=("throttle",),
        source="first-order lag of the drive; after Ljung (1999), ch. 4",
    ),
    Effect(
        motor_dead_zone, "throttle reference reduced by w, not below 0",
        (Parameter("width", "m s^-1", 0.0, 1.0, 0.13, "width"),),
        "motor", depends_on=("throttle",), confounded_with="the throttle's zero (c in the vehicle file)",
        source="dead zone of the throttle; a standard actuator nonlinearity",
    ),
    Effect(
        motor_sag, "throttle force × (1 − s·t/T)", (Parameter("s", "1", -1.0, 0.95, 0.27, "share lost at the end"),),
        "motor", looks_like=("mass_change",), depends_on=("time", "throttle"),
        source="battery voltage falling with time; linear over the recording",
    ),
    Effect(
        motor_power_limit, "throttle force ≤ P/max(abs(v_fx), 0.2)",
        (Parameter("inverse_P", "kg^-1 m^-2 s^3", 0.0, 0.1, 0.0055, "inverse of the largest power", inverse_of="P"),),
        "motor", depends_on=("throttle", "v_x"), source="constant-power limit of a drive; Gillespie (1992), ch. 2",
    ),
    Effect(
        motor_regeneration, "throttle brakes above its reference with the share r of K_t",
        (Parameter("r", "1", 0.0, 1.0, 0.22, "share of K_t"),),
        "motor", looks_like=("front_coulomb_friction",), depends_on=("throttle", "v_x"),
        source="a speed controller that brakes above its reference with a share of its gain",
    ),
)  # fmt: skip

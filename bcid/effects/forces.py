"""Forces and moments on the body that the base model leaves out: rolling, air, scrub, ground.

Each law returns what is added to F_x, F_y (N) or M_z (N m) on the body, or to the drag F_d (N) of the front wheel.
"""

import math

from bcid.compiled.lanes import where
from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter
from bcid.physics.elementary import sincos

N = "kg m s^-2"
N_S_PER_M = "kg s^-1"


@njit
def rear_rolling_coulomb(v_x: float, c: float, v_c: float) -> float:
    """Force along the body -c tanh(v_x/v_c) (N): dry friction c (N) of the rear wheels, full well above v_c (m/s)."""
    return -c * math.tanh(v_x / v_c) if c != 0.0 else 0.0


@njit
def rear_rolling_viscous(v_x: float, b: float) -> float:
    """Force along the body -b v_x (N): viscous friction b (N s/m) of the rear wheels at the speed v_x (m/s)."""
    return -b * v_x


@njit
def front_coulomb_friction(v_fx: float, c: float, v_c: float) -> float:
    """Drag of the front wheel c tanh(v_fx/v_c) (N): dry friction c (N), full at rolling speeds well above v_c (m/s)."""
    return c * math.tanh(v_fx / v_c) if c != 0.0 else 0.0


@njit
def quadratic_drag(v_x: float, v_y: float, k: float) -> tuple[float, float]:
    """Air drag -k |V| V (N), along and across the body, at the velocity V = (v_x, v_y) (m/s) in the body frame."""
    if k == 0.0:
        return 0.0, 0.0
    drag = -k * math.hypot(v_x, v_y)
    return drag * v_x, drag * v_y


@njit
def rear_drag_asymmetry(v_x: float, omega: float, b: float, track: float) -> tuple[float, float]:
    """Force along the body (N) and moment (N m) of a drag |b| (N s/m) on one rear wheel, the left one where b > 0.

    F = -|b| (v_x - y omega) at the wheel's place y = +-track/2 (m), M_z = -y F.
    """
    lever = math.copysign(0.5 * track, b)
    F_x = -abs(b) * (v_x - lever * omega)
    return F_x, -lever * F_x


@njit
def steering_drag(delta_w: float, v_fx: float, k: float) -> float:
    """Drag of the front wheel k |delta_w| v_fx (N) at its angle delta_w (rad) and rolling speed v_fx (m/s)."""
    return k * abs(delta_w) * v_fx


@njit
def steering_friction(delta_w: float, v_fx: float, c: float, v_c: float) -> float:
    """Drag of the front wheel c |delta_w| tanh(v_fx/v_c) (N): dry friction c (N/rad) per angle delta_w (rad).

    It is full at rolling speeds v_fx well above v_c (m/s).
    """
    return c * abs(delta_w) * math.tanh(v_fx / v_c) if c != 0.0 else 0.0


@njit
def is_in_circle(p_x: float, p_y: float, x: float, y: float, radius: float) -> bool:
    """Whether the point (p_x, p_y) lies within `radius` of (x, y), all in m."""
    return (p_x - x) * (p_x - x) + (p_y - y) * (p_y - y) < radius * radius


@njit
def rough_patch(p_x: float, p_y: float, v_fx: float, b: float, x: float, y: float, radius: float) -> float:
    """Drag of the front wheel b v_fx (N) while the CoG (p_x, p_y) is within `radius` of (x, y) (all in m), else 0.

    `v_fx` is the wheel's rolling speed (m/s), `b` the drag per speed (N s/m) of the rough floor.
    """
    return where(is_in_circle(p_x, p_y, x, y, radius), b * v_fx, 0.0) if b != 0.0 else 0.0


@njit
def floor_slope(m: float, g_x: float, g_y: float) -> tuple[float, float]:
    """Force (m g_x, m g_y) (N, world) on a mass m (kg): gravity along an inclined floor, g_x, g_y in m/s^2."""
    return m * g_x, m * g_y


@njit
def tether_pull(p_x: float, p_y: float, k: float, x: float, y: float, r_0: float) -> tuple[float, float]:
    """Force (N) in the world frame on the CoG at (p_x, p_y) from a cable that is fixed at (x, y) (all in m).

    Its size is k (r - r_0) towards (x, y) at a distance r (m) beyond the slack length r_0, and 0 within; k is in
    N/m.
    """
    if k == 0.0:
        return 0.0, 0.0
    r = math.hypot(x - p_x, y - p_y)
    taut = (r > r_0) & (r > 0.0)
    pull = where(taut, k * (r - r_0) / where(taut, r, 1.0), 0.0)
    return pull * (x - p_x), pull * (y - p_y)


@njit
def yaw_scrub(omega: float, c: float) -> float:
    """Moment -c omega (N m): viscous friction c (N m s) of scrubbing wheels at the yaw rate omega (rad/s)."""
    return -c * omega


@njit
def yaw_coulomb(omega: float, c: float, w_c: float) -> float:
    """Moment -c tanh(omega/w_c) (N m): dry friction c (N m) of scrubbing wheels, full well above w_c (rad/s)."""
    return -c * math.tanh(omega / w_c) if c != 0.0 else 0.0


@njit
def drive_lateral_offset(F_l: float, delta_w: float, F_lr: float, a: float) -> float:
    """Moment a (F_l cos(delta_w) + F_lr) (N m) of drive forces (N) that act `a` metres to the right of the CoG.

    F_l is the front wheel's, along the wheel at the angle delta_w (rad); F_lr is the rear wheels', along the body.
    """
    return a * (F_l * sincos(delta_w)[1] + F_lr) if a != 0.0 else 0.0


FAR = 1e7  # m: a floor may lie anywhere in its frame, a map's as well
PLACE = (
    Parameter("x", "m", -FAR, FAR, 0.0, "centre", is_place=True),
    Parameter("y", "m", -FAR, FAR, 0.0, "centre", is_place=True),
)
RADIUS = Parameter("radius", "m", 0.3, 5.0, 1.2, "radius of the circle", 1.0, is_place=True)

EFFECTS = (
    Effect(
        rear_rolling_coulomb, "F_x −= c·tanh(v_x/0.05)",
        (Parameter("c", N, 0.0, 2000.0, 20.0, "Coulomb rolling resistance of the rear wheels"),),
        "fx", looks_like=("rear_rolling_viscous",), depends_on=("v_x",),
        source="dry friction of bearings and rolling resistance; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        rear_rolling_viscous, "F_x −= b·v_x",
        (Parameter("b", N_S_PER_M, 0.0, 2000.0, 17.0, "viscous rolling resistance of the rear wheels"),),
        "fx", looks_like=("quadratic_drag", "yaw_scrub"), depends_on=("v_x",),
        source="viscous friction of bearings; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        front_coulomb_friction, "F_d += c·tanh(v_fx/0.05)",
        (Parameter("c", N, 0.0, 2000.0, 60.0, "Coulomb rolling resistance of the front wheel"),),
        "fx", looks_like=("rear_rolling_coulomb",), depends_on=("v_x", "steering"),
        source="dry friction in the drive train; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        quadratic_drag, "F −= k·abs(V)·V", (Parameter("k", "kg m^-1", 0.0, 500.0, 11.0, "drag per squared speed"),),
        "fx", looks_like=("rear_rolling_viscous", "yaw_scrub"), depends_on=("speed",),
        source="air drag; Gillespie (1992), ch. 4",
    ),
    Effect(
        rear_drag_asymmetry, "F = −abs(b)(v_x ∓ ω·track/2) at the left (b > 0) or right rear wheel",
        (Parameter("b", N_S_PER_M, -500.0, 500.0, 13.0, "drag of one rear wheel"),),
        "fx", looks_like=("rear_rolling_viscous",), depends_on=("v_x", "yaw_rate"),
        source="a dragging wheel: force at its hub and its moment about the CoG",
    ),
    Effect(
        steering_drag, "F_d += k·abs(δ_w)·v_fx",
        (Parameter("k", "kg s^-1 rad^-1", 0.0, 3000.0, 23.0, "drag of the steered wheel per angle"),),
        "fx", looks_like=("quadratic_drag",), depends_on=("steering", "v_x"),
        source="drag of a steered wheel that scrubs, linear in the angle; after Gillespie (1992), ch. 6",
    ),
    Effect(
        steering_friction, "F_d += c·abs(δ_w)·tanh(v_fx/0.05)",
        (Parameter("c", "kg m s^-2 rad^-1", 0.0, 3000.0, 20.0, "dry friction of the steered wheel per angle"),),
        "fx", looks_like=("steering_drag", "front_coulomb_friction"), depends_on=("steering", "v_x"),
        source="dry friction of a steered wheel that scrubs, linear in the angle; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        rough_patch, "F_d += b·v_fx while the CoG is in the circle",
        (Parameter("b", N_S_PER_M, 0.0, 1000.0, 28.0, "drag there"), *PLACE, RADIUS),
        "fx", "environment", depends_on=("place",),
        source="viscous rolling resistance of another floor covering, within a circle",
    ),
    Effect(
        floor_slope, "world acceleration (g_x, g_y)",
        (
            Parameter("g_x", "m s^-2", -1.0, 1.0, 0.035, "along the floor's x"),
            Parameter("g_y", "m s^-2", -1.0, 1.0, 0.035, "along the floor's y"),
        ),
        "fx", "environment", ("tether_pull",), ("heading",), source="gravity along an inclined plane",
    ),
    Effect(
        tether_pull, "pull k(r − r_0) toward (x, y) beyond r_0",
        (
            Parameter("k", "kg s^-2", 0.0, 500.0, 9.0, "stiffness of the cable"),
            *PLACE, Parameter("r_0", "m", 0.0, 20.0, 1.0, "slack", is_place=True),
        ),
        "fx", "environment", ("floor_slope",), ("place", "heading"),
        source="Hooke's law for a cable beyond its slack length",
    ),
    Effect(
        yaw_scrub, "M_z −= c·ω", (Parameter("c", "kg m^2 s^-1 rad^-1", 0.0, 1000.0, 13.0, "yaw damping"),),
        "mz", looks_like=("rear_rolling_viscous", "marker_offset"), depends_on=("yaw_rate",),
        source="damping moment of wheels that turn on the spot; linear",
    ),
    Effect(
        yaw_coulomb, "M_z −= c·tanh(ω/0.05)",
        (Parameter("c", "kg m^2 s^-2", 0.0, 500.0, 17.0, "Coulomb yaw friction"),),
        "mz", looks_like=("yaw_scrub",), depends_on=("yaw_rate",),
        source="dry friction of wheels that turn on the spot; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        drive_lateral_offset, "M_z += a·(F_m − F_d)·cos δ_w",
        (Parameter("a", "m", -1.0, 1.0, 0.15, "the driven wheel's offset to the right"),),
        "mz", looks_like=("steering_offset",), depends_on=("throttle", "steering"),
        source="lever of the drive force about the CoG",
    ),
)  # fmt: skip

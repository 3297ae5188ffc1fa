"""Forces and moments on the body that the base model leaves out: rolling, air, scrub, ground.

Each function returns what is added to F_x, F_y (N) or M_z (N m), or to the drag F_d of the front wheel.
"""

from __future__ import annotations

import math

from bcid.compiled.lanes import where
from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter
from bcid.physics.elementary import sincos

N = "kg m s^-2"
N_S_PER_M = "kg s^-1"


@njit
def rear_rolling_coulomb(v_x: float, c: float, v_c: float) -> float:
    """F_x -= c tanh(v_x / 0.05 m/s)."""
    return -c * math.tanh(v_x / v_c) if c != 0.0 else 0.0


@njit
def rear_rolling_viscous(v_x: float, b: float) -> float:
    """F_x -= b v_x."""
    return -b * v_x


@njit
def front_coulomb_friction(v_fx: float, c: float, v_c: float) -> float:
    """F_d += c tanh(v_fx / 0.05 m/s)."""
    return c * math.tanh(v_fx / v_c) if c != 0.0 else 0.0


@njit
def quadratic_drag(v_x: float, v_y: float, k: float) -> tuple[float, float]:
    """F -= k |V| V."""
    if k == 0.0:
        return 0.0, 0.0
    drag = -k * math.hypot(v_x, v_y)
    return drag * v_x, drag * v_y


@njit
def rear_drag_asymmetry(v_x: float, omega: float, b: float, track: float) -> tuple[float, float]:
    """Drag |b| on the left rear wheel (b > 0) or the right one: F_x = -|b| (v_x -+ omega track/2), and its moment."""
    lever = math.copysign(0.5 * track, b)
    F_x = -abs(b) * (v_x - lever * omega)
    return F_x, -lever * F_x


@njit
def steering_drag(delta_w: float, v_fx: float, k: float) -> float:
    """F_d += k |delta_w| v_fx."""
    return k * abs(delta_w) * v_fx


@njit
def inside(p_x: float, p_y: float, x: float, y: float, radius: float) -> bool:
    """Whether the CoG is in the circle."""
    return (p_x - x) * (p_x - x) + (p_y - y) * (p_y - y) < radius * radius


@njit
def tether(p_x: float, p_y: float, k: float, x: float, y: float, r_0: float) -> tuple[float, float]:
    """World force k (r - r_0) toward (x, y) beyond r_0."""
    if k == 0.0:
        return 0.0, 0.0
    r = math.hypot(x - p_x, y - p_y)
    taut = (r > r_0) & (r > 0.0)
    pull = where(taut, k * (r - r_0) / where(taut, r, 1.0), 0.0)
    return pull * (x - p_x), pull * (y - p_y)


@njit
def yaw_scrub(omega: float, c: float) -> float:
    """M_z -= c omega."""
    return -c * omega


@njit
def yaw_coulomb(omega: float, c: float, w_c: float) -> float:
    """M_z -= c tanh(omega / 0.05 rad/s)."""
    return -c * math.tanh(omega / w_c) if c != 0.0 else 0.0


@njit
def drive_lateral_offset(F_l: float, delta_w: float, F_lr: float, a: float) -> float:
    """M_z += a (F_m - F_d) cos(delta_w), of the front wheel; a driven rear one pulls along the body."""
    return a * (F_l * sincos(delta_w)[1] + F_lr) if a != 0.0 else 0.0


FAR = 1e7  # m: a floor may lie anywhere in its frame, a map's as well
PLACE = (
    Parameter("x", "m", -FAR, FAR, 0.0, "centre", places=True),
    Parameter("y", "m", -FAR, FAR, 0.0, "centre", places=True),
)
RADIUS = Parameter("radius", "m", 0.3, 5.0, 1.2, "radius of the circle", 1.0, places=True)

EFFECTS = (
    Effect(
        "rear_rolling_coulomb", "F_x −= c·tanh(v_x/0.05)",
        (Parameter("c", N, 0.0, 2000.0, 20.0, "Coulomb rolling resistance of the rear wheels"),),
        "fx", looks_like=("rear_rolling_viscous",), depends_on=("v_x",),
        source="dry friction of bearings and rolling resistance; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        "rear_rolling_viscous", "F_x −= b·v_x",
        (Parameter("b", N_S_PER_M, 0.0, 2000.0, 17.0, "viscous rolling resistance of the rear wheels"),),
        "fx", looks_like=("quadratic_drag", "yaw_scrub"), depends_on=("v_x",),
        source="viscous friction of bearings; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        "front_coulomb_friction", "F_d += c·tanh(v_fx/0.05)",
        (Parameter("c", N, 0.0, 2000.0, 60.0, "Coulomb rolling resistance of the front wheel"),),
        "fx", looks_like=("rear_rolling_coulomb",), depends_on=("v_x", "steering"),
        source="dry friction in the drive train; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        "quadratic_drag", "F −= k·abs(V)·V",
        (Parameter("k", "kg m^-1", 0.0, 500.0, 11.0, "drag per squared speed"),),
        "fx", looks_like=("rear_rolling_viscous", "yaw_scrub"), depends_on=("speed",),
        source="air drag; Gillespie (1992), ch. 4",
    ),
    Effect(
        "rear_drag_asymmetry", "F = −abs(b)(v_x ∓ ω·track/2) at the left (b > 0) or right rear wheel",
        (Parameter("b", N_S_PER_M, -500.0, 500.0, 13.0, "drag of one rear wheel"),),
        "fx", looks_like=("rear_rolling_viscous",), depends_on=("v_x", "yaw_rate"),
        source="a dragging wheel: force at its hub and its moment about the CoG",
    ),
    Effect(
        "steering_drag", "F_d += k·abs(δ_w)·v_fx",
        (Parameter("k", "kg s^-1 rad^-1", 0.0, 3000.0, 23.0, "drag of the steered wheel per angle"),),
        "fx", looks_like=("quadratic_drag",), depends_on=("steering", "v_x"),
        source="drag of a steered wheel that scrubs, linear in the angle; after Gillespie (1992), ch. 6",
    ),
    Effect(
        "rough_patch", "F_d += b·v_fx while the CoG is in the circle",
        (Parameter("b", N_S_PER_M, 0.0, 1000.0, 28.0, "drag there"), *PLACE, RADIUS),
        "fx", "environment", depends_on=("place",),
        source="viscous rolling resistance of another floor covering, within a circle",
    ),
    Effect(
        "floor_slope", "world acceleration (g_x, g_y)",
        (
            Parameter("g_x", "m s^-2", -1.0, 1.0, 0.035, "along the floor's x"),
            Parameter("g_y", "m s^-2", -1.0, 1.0, 0.035, "along the floor's y"),
        ),
        "fx", "environment", ("tether_pull",), ("heading",),
        source="gravity along an inclined plane",
    ),
    Effect(
        "tether_pull", "pull k(r − r_0) toward (x, y) beyond r_0",
        (
            Parameter("k", N_S_PER_M.replace("s^-1", "s^-2"), 0.0, 500.0, 9.0, "stiffness of the cable"),
            *PLACE, Parameter("r_0", "m", 0.0, 20.0, 1.0, "slack", places=True),
        ),
        "fx", "environment", ("floor_slope",), ("place", "heading"),
        source="Hooke's law for a cable beyond its slack length",
    ),
    Effect(
        "yaw_scrub", "M_z −= c·ω",
        (Parameter("c", "kg m^2 s^-1 rad^-1", 0.0, 1000.0, 13.0, "yaw damping"),),
        "mz", looks_like=("rear_rolling_viscous", "marker_offset"), depends_on=("yaw_rate",),
        source="damping moment of wheels that turn on the spot; linear",
    ),
    Effect(
        "yaw_coulomb", "M_z −= c·tanh(ω/0.05)",
        (Parameter("c", "kg m^2 s^-2", 0.0, 500.0, 17.0, "Coulomb yaw friction"),),
        "mz", looks_like=("yaw_scrub",), depends_on=("yaw_rate",),
        source="dry friction of wheels that turn on the spot; Armstrong-Hélouvry et al. (1994)",
    ),
    Effect(
        "drive_lateral_offset", "M_z += a·(F_m − F_d)·cos δ_w",
        (Parameter("a", "m", -1.0, 1.0, 0.15, "the driven wheel's offset to the right"),),
        "mz", looks_like=("steering_offset",), depends_on=("throttle", "steering"),
        source="lever of the drive force about the CoG",
    ),
)  # fmt: skip

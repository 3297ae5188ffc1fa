"""How the recorded pose and its time differ from the car's; and the car's mass, which may change on the way."""

from bcid.aliases import Floats, Switches
from bcid.compiled.lanes import where
from bcid.compiled.njit import njit
from bcid.effects.entry import Effect, Parameter
from bcid.physics.elementary import sincos


@njit
def mass_change(t: float, d: float, t_s: float) -> float:
    """Factor on mass and moment of inertia at the time t (s) of a recording: 1 before t_s (s), 1 + d from then on."""
    return where(t >= t_s, 1.0 + d, 1.0) if d != 0.0 else 1.0


@njit
def pose_latency(time: Floats, tau: float) -> Floats:
    """Times t + tau (n,) (s) of commands given at the times t; poses stamped tau late are equivalent to this."""
    return time + tau


@njit
def clock_drift(time: Floats, rho: float) -> Floats:
    """Times t (1 + rho) (n,) (s) on the pose clock, which drifts by rho, at the times t (n,) of the command clock."""
    return time * (1.0 + rho)


@njit
def marker_offset(p_x: float, p_y: float, theta: float, d_x: float, d_y: float) -> tuple[float, float]:
    """World position (m) of the tracked point, d_x ahead and d_y left of the CoG (p_x, p_y), at yaw theta (rad)."""
    sin_t, cos_t = sincos(theta)
    return p_x + cos_t * d_x - sin_t * d_y, p_y + sin_t * d_x + cos_t * d_y


@njit
def body_yaw_misalignment(theta: float, psi: float) -> float:
    """Tracked yaw theta + psi (rad) at heading theta: the tracked body's x axis is turned by psi against the car's."""
    return theta + psi


@njit
def pose_scale(x: float, y: float, kappa: float) -> tuple[float, float]:
    """Tracked position (1 + kappa) (x, y) (m): the length scale of the tracking is off by kappa."""
    return x + kappa * x, y + kappa * y


@njit
def tracked_pose(p_x: float, p_y: float, theta: float, e: Switches) -> tuple[float, float, float]:
    """Tracked pose x, y (m), yaw (rad) in the world of a car whose CoG is at (p_x, p_y) (m) with heading theta (rad).

    The marker offset, length scale and yaw misalignment are read from the effects' parameters `e`.
    """
    x, y = marker_offset(p_x, p_y, theta, e.marker_offset__d_x, e.marker_offset__d_y)
    x, y = pose_scale(x, y, e.pose_scale__kappa)
    return x, y, body_yaw_misalignment(theta, e.body_yaw_misalignment__psi)


@njit
def to_pose_clock(time: Floats, e: Switches) -> Floats:
    """Times (n,) (s) on the pose clock, (t + tau)(1 + rho), of commands given at `time` (n,) on the command clock.

    The pose latency tau and the relative clock drift rho are read from the effects' parameters `e`.
    """
    return clock_drift(pose_latency(time, e.pose_latency__tau), e.clock_drift__rho)


_HELD = "the vehicle file's lengths"

EFFECTS = (
    Effect(
        mass_change, "m, I_z × (1 + d) from t_s on",
        (
            Parameter("d", "1", -0.5, 3.0, 0.1, "relative change"),  # a load is seldom more than the car
            Parameter("t_s", "s", 0.0, 1e5, 0.0, "when", is_place=True),
        ),
        "any", looks_like=("motor_sag",), depends_on=("time",), source="added load: m and I_z in proportion",
    ),
    Effect(
        pose_latency, "pose arrives τ late against the commands", (Parameter("tau", "s", -0.3, 0.3, 0.011, "latency"),),
        "time", "measurement", ("steering_delay",), ("steering_rate", "throttle"),
        source="delay of the tracking system against the command clock",
    ),
    Effect(
        clock_drift, "the pose clock runs (1 + ρ) times the command clock",
        (Parameter("rho", "1", -1e-3, 1e-3, 3.5e-5, "drift"),),
        "time", "measurement", ("pose_latency",), ("time", "steering_rate"),
        source="two clocks at a constant rate ratio",
    ),
    Effect(
        marker_offset, "tracked point at (d_x, d_y) from the CoG",
        (
            # markers stand on the car: none is farther than half a wheelbase or so
            Parameter("d_x", "m", -0.5, 0.5, 0.02, "ahead"),
            Parameter("d_y", "m", -0.5, 0.5, 0.02, "to the left"),
        ),
        "pose", "measurement", ("yaw_scrub",), ("yaw_rate",), _HELD,
        source="rigid-body kinematics: the tracked point is not the CoG",
    ),
    Effect(
        body_yaw_misalignment, "tracked yaw = θ + ψ", (Parameter("psi", "rad", -0.5, 0.5, 0.014, "angle"),),
        "pose", "measurement", ("steering_offset",), ("v_x",), source="the tracked body's x axis is not the car's",
    ),
    Effect(
        pose_scale, "tracked positions × (1 + κ)", (Parameter("kappa", "1", -0.5, 0.5, 0.06, "excess"),),
        "pose", "measurement", depends_on=("speed",), confounded_with=_HELD,
        source="wrong length scale of the tracking calibration",
    ),
)  # fmt: skip

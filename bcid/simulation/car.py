"""The simulated car's constants: the paper's car, extras that a real one has, and effects to conceal.

Every extra and effect is off at exactly zero; with all off it is the paper's car, in an implementation of its own.
"""

import difflib
from collections.abc import Sequence
from typing import NamedTuple

from bcid.errors import UsageError


class Plant(NamedTuple):
    """Constants in SI; the first block is the paper's Table `parameters` (motor and drag: errata 6, 13)."""

    mass: float = 319.6
    inertia: float = 90.85
    front_lever: float = 0.54
    rear_lever: float = 0.33
    angle_limit: float = 2.012
    servo_time: float = 0.155
    servo_rate: float = 1.418
    top_speed: float = 2.033
    motor_limit: float = 423.4
    motor_gain: float = 274.8
    brake_gain: float = 597.0
    front_stiffness: float = 3594.0
    rear_stiffness: float = 7840.0
    front_grip: float = 629.6
    rear_grip: float = 1360.0
    rolling_drag: float = 43.4
    rolling_drag_2: float = 4.0  # the Table's -15.61 would drive above 2.78 m/s
    slip_speed: float = 1.0

    # other drive trains than the paper's: zero is its car
    rear_drive: float = 0.0  # share of motor force and rolling drag at the rear axle
    throttle_force: float = 0.0  # N per unit throttle where the throttle sets a force, not a speed
    motor_fade: float = 0.0  # N s/m that such a motor loses with the speed
    pulsed_fade: float = 0.0  # N s/m at full throttle that it loses besides, in proportion to the throttle
    reverses: float = 0.0  # 1 where a throttle below zero drives backward and does not brake

    # laws of another shape than the vocabulary's (`other_laws`): zero keeps the usual one
    zone_steepness: float = 0.0  # per unit throttle, of a motor whose dead zone ends smoothly
    dry_speed: float = 0.0  # m/s in which the dry rolling friction sets in, where it is not the usual 0.05
    front_magic: float = 0.0  # shape factor of Pacejka's formula, for the front tyre
    rear_magic: float = 0.0
    magic_curvature: float = 0.0  # its curvature factor, for all tyres
    slip_fade: float = 0.0  # s^2/m^2, slip is divided by |v| + slip_speed exp(-slip_fade v^2)
    dry_steered_drag: float = 0.0  # N/rad, nearly dry drag of a steered wheel
    dry_steered_rise: float = 0.0  # s/m, share by which it grows with the speed
    left_reach: float = 0.0  # rad, limits towards which the linkage's angle bends; zero for both: it does not
    right_reach: float = 0.0
    linkage_centre: float = 0.0  # rad of the servo, where such a linkage changes sides
    servo_damping: float = 0.0  # damping ratio of a servo of second order

    # extras of a real car: zero switches each off
    rear_track: float = 0.0  # m between the two rear wheels
    rear_bearing: float = 0.0  # N, Coulomb drag of the rear axle
    rear_rolling: float = 0.0  # N s/m
    softness: float = 0.0  # 0 clipped tyres, 1 tanh tyres
    tyre_fall: float = 0.0  # share of the grip lost far past saturation
    rough_force: float = 0.0  # N, standard deviation of the floor's random force
    rough_moment: float = 0.0  # N m

    # effects to conceal, by the id they carry in the vocabulary
    rear_rolling_coulomb: float = 0.0
    rear_rolling_viscous: float = 0.0
    front_coulomb_friction: float = 0.0
    quadratic_drag: float = 0.0
    rear_drag_asymmetry: float = 0.0
    asymmetry_track: float = 0.6
    steering_drag: float = 0.0
    steering_friction: float = 0.0
    rough_patch: float = 0.0
    rough_patch_x: float = 0.0
    rough_patch_y: float = 0.0
    rough_patch_radius: float = 1.0
    floor_slope_x: float = 0.0
    floor_slope_y: float = 0.0
    tether_pull: float = 0.0
    tether_x: float = 0.0
    tether_y: float = 0.0
    tether_slack: float = 0.0
    mass_change: float = 0.0
    mass_change_at: float = 0.0
    yaw_scrub: float = 0.0
    yaw_coulomb: float = 0.0
    drive_lateral_offset: float = 0.0
    tyre_relaxation: float = 0.0
    friction_circle: float = 0.0
    tyre_soft_saturation: float = 0.0
    load_transfer: float = 0.0
    front_ply_steer: float = 0.0
    rear_toe: float = 0.0
    slippery_patch: float = 0.0
    slippery_patch_x: float = 0.0
    slippery_patch_y: float = 0.0
    slippery_patch_radius: float = 1.0
    motor_delay: float = 0.0
    motor_lag: float = 0.0
    motor_dead_zone: float = 0.0
    motor_sag: float = 0.0
    inverse_power_limit: float = 0.0  # 1/W
    motor_regeneration: float = 0.0
    steering_offset: float = 0.0
    steering_backlash: float = 0.0
    steering_dead_band: float = 0.0
    steering_delay: float = 0.0
    steering_lag: float = 0.0
    steering_nonlinearity: float = 0.0
    steering_side_gain: float = 0.0
    steering_speed_gain: float = 0.0
    steering_rate_asymmetry: float = 0.0
    steering_compliance: float = 0.0

    # effects to conceal that have no id in any vocabulary
    drive_unevenness: float = 0.0  # N, comes and goes with the way that the driven wheel has rolled
    rear_roll_steer: float = 0.0  # rad s^2/m, the rear axle steers with the lateral acceleration
    tyre_wear: float = 0.0  # share of all grip lost by the end
    motor_ripple: float = 0.0  # share of the motor's force, comes and goes with the speed
    motor_dropout: float = 0.0  # share of the motor's force lost for a moment, again and again
    steering_shimmy: float = 0.0  # rad, the wheel swings by itself
    steering_reaction: float = 0.0  # N m s, moment against the servo's rate
    washboard: float = 0.0  # N, a floor of waves along x
    tyre_warming: float = 0.0  # share of the front stiffness lost in the middle of the take, and regained
    bearing_heat: float = 0.0  # N, dry friction that comes until the middle of the take, and goes
    steering_creep: float = 0.0  # rad, the servo's zero wanders until the middle of the take, and back
    motor_heating: float = 0.0  # share of its force that a motor loses when it is hot
    brake_fading: float = 0.0  # share of its force that a brake loses when it is hot
    stick_slip: float = 0.0  # N, friction that is there near standstill only
    stick_speed: float = 0.3  # m/s in which it fades
    floor_stripes: float = 0.0  # N, dry friction on stripes across y
    attraction: float = 0.0  # N, towards a magnet, at its strongest
    attraction_x: float = 0.0
    attraction_y: float = 0.0
    attraction_reach: float = 1.0  # m, where it is strongest
    floor_sway: float = 0.0  # N, to and fro in time
    gusts: float = 0.0  # N, wind from one side of the room, felt broadside
    compass_moment: float = 0.0  # N m, turns the car towards one heading
    swinging_load: float = 0.0  # share of the mass that hangs on springs


class Sensor(NamedTuple):
    """The motion capture: rate, noise, dropouts, and measurement effects to conceal."""

    rate_hz: float = 60.0
    position_noise: float = 5e-4  # m
    yaw_noise: float = 1e-3  # rad
    dropouts_per_minute: float = 1.0
    longest_dropout: float = 0.2  # s
    pose_latency: float = 0.0
    clock_drift: float = 0.0
    marker_offset_x: float = 0.0
    marker_offset_y: float = 0.0
    body_yaw_misalignment: float = 0.0
    pose_scale: float = 0.0
    lens_distortion: float = 0.0  # 1/m^2, positions grow with the square of the distance from the middle
    camera_shake: float = 0.0  # m, all cameras shake together


REAL_EXTRAS = {
    "rear_track": 0.6, "rear_bearing": 6.0, "rear_rolling": 8.0, "softness": 0.6,
    "rough_force": 4.0, "rough_moment": 1.5,
}  # fmt: skip
"""What makes the simulated car differ from every fitted model, as a real one does."""

NOT_NEGATIVE = (
    "friction_circle", "motor_regeneration", "motor_lag", "motor_delay", "motor_dead_zone", "motor_power_limit",
    "steering_lag", "steering_delay", "steering_backlash", "steering_dead_band", "tyre_relaxation", "softness",
    "tyre_soft_saturation", "tyre_fall", "rear_track", "rough_force", "rough_moment", "motor_heating", "brake_fading",
    "swinging_load", "stick_speed", "attraction_reach", "zone_steepness", "dry_speed", "front_magic", "rear_magic",
    "slip_fade", "left_reach", "right_reach", "servo_damping",
)  # fmt: skip
"""Constants that mean nothing below zero."""


def configure_simulation(ideal: bool, changes: Sequence[str], rate_hz: float) -> tuple[Plant, Sensor]:
    """Constants of the simulated car and of its motion capture, with `changes` such as "motor_lag=0.1".

    `rate_hz` (Hz) is the capture's frame rate.  Unless `ideal`, the car has what a real one adds to the paper's: two
    rear wheels, rear drag, soft tyres, a rough floor.

    Raises:
        UsageError: a name is unknown, a value is no number, or it is below zero where it must not be.
    """
    plant: dict[str, float] = {} if ideal else dict(REAL_EXTRAS)
    sensor: dict[str, float] = {"rate_hz": rate_hz}
    for change in changes:
        name, _, text = change.partition("=")
        try:
            value = float(text)
        except ValueError:
            raise UsageError(f"--set {change}: {text!r} is no number\n  next: write NAME=VALUE") from None
        if name in NOT_NEGATIVE and value < 0.0:
            raise UsageError(f"--set {change}: {name} cannot be negative\n  next: give a value from 0 up")
        if name == "motor_power_limit":  # the vocabulary's id, in W; off at infinity
            plant["inverse_power_limit"] = 1.0 / value if value > 0.0 else 0.0
        elif name in Plant._fields:
            plant[name] = value
        elif name in Sensor._fields:
            sensor[name] = value
        else:
            near = difflib.get_close_matches(name, [*Plant._fields, *Sensor._fields], n=3)
            raise UsageError(
                f"--set {change}: there is no constant {name!r}\n  next: try {', '.join(near) or 'another'}"
            )
    return Plant(**plant), Sensor(**sensor)

"""What acts on the body from outside or by its motion alone: floor, air, cables, magnets, wind, a load on springs."""

import math

from bcid.compiled.njit import njit
from bcid.simulation.car import Plant

WAVES_M = 0.65  # of floor per radian
STRIPES_M = 0.16  # of floor per radian: a stripe each metre
SWAY_S = 2.7  # in which the floor sways once
GUSTS_S, BURSTS_S = 3.1, 17.0  # a gust each, and how they gather
WIND_FROM = 0.9  # rad, where the wind blows to in the world
LONGWAYS = 0.3  # share of the wind's force that a car feels which heads along it
COMPASS_RAD = 0.6  # heading at which a magnet on the car rests
LOAD_RADPS, LOAD_DAMPING = 9.0, 0.15  # a load on springs: 1.4 Hz


@njit
def is_in_circle(x: float, y: float, centre_x: float, centre_y: float, radius: float) -> bool:
    """Whether the point (x, y) lies within `radius` of the centre, all in m."""
    return (x - centre_x) ** 2 + (y - centre_y) ** 2 < radius * radius


@njit
def swell(time: float, duration: float) -> float:
    """How far along a change is that comes and goes over a take: 0 at both ends, 1 in the middle (s of s)."""
    return math.sin(math.pi * time / duration) ** 2


@njit
def add_resistances(
    body_x: float, body_y: float, moment: float, along: float, across: float, turn: float, p: Plant
) -> tuple[float, float, float]:
    """Body force (N) and moment (N m) with rolling, air and yaw friction added, at twist (along, across, turn)."""
    dry_speed = p.dry_speed if p.dry_speed > 0.0 else 0.05
    body_x -= p.rear_rolling_coulomb * math.tanh(along / dry_speed) + p.rear_rolling_viscous * along
    if p.rear_drag_asymmetry != 0.0:
        offset = math.copysign(0.5 * p.asymmetry_track, p.rear_drag_asymmetry)
        resist = abs(p.rear_drag_asymmetry) * (along - offset * turn)
        body_x -= resist
        moment += offset * resist
    speed = math.hypot(along, across)
    body_x -= p.quadratic_drag * speed * along
    body_y -= p.quadratic_drag * speed * across
    moment -= p.yaw_scrub * turn + p.yaw_coulomb * math.tanh(turn / 0.05)
    return body_x, body_y, moment


@njit
def add_unnamed_forces(
    body_x: float, body_y: float, moment: float, along: float, heading: float, y: float, time: float, duration: float,
    p: Plant,
) -> tuple[float, float, float]:  # fmt: skip
    """Body force (N) and moment (N m) with what has no name added: stiction, hot bearings, stripes, wind, magnet.

    The car rolls at `along` (m/s) with the given `heading` (rad), its CoG at `y` (m), at `time` (s) of `duration` (s).
    """
    grab = p.stick_slip * math.exp(-abs(along) / p.stick_speed) + p.bearing_heat * swell(time, duration)
    if p.floor_stripes != 0.0 and math.sin(y / STRIPES_M) > 0.3:
        grab += p.floor_stripes
    body_x -= grab * math.tanh(along / 0.05)
    if p.gusts != 0.0:
        pulse = max(math.sin(2.0 * math.pi * time / GUSTS_S) * math.sin(2.0 * math.pi * time / BURSTS_S), 0.0)
        body_x += LONGWAYS * p.gusts * pulse * math.cos(WIND_FROM - heading)
        body_y += p.gusts * pulse * math.sin(WIND_FROM - heading)
    return body_x, body_y, moment - p.compass_moment * math.sin(heading - COMPASS_RAD)


@njit
def pull_of_place(x: float, y: float, time: float, p: Plant) -> tuple[float, float]:
    """Force (N) in the world frame on a car at (x, y) (m) and `time` (s): cable, waves, magnet, sway."""
    world_x, world_y = 0.0, 0.0
    if p.tether_pull != 0.0:
        gap_x, gap_y = p.tether_x - x, p.tether_y - y
        reach = math.hypot(gap_x, gap_y)
        if reach > p.tether_slack and reach > 0.0:
            world_x += p.tether_pull * (reach - p.tether_slack) * gap_x / reach
            world_y += p.tether_pull * (reach - p.tether_slack) * gap_y / reach
    world_x += p.washboard * math.sin(x / WAVES_M)
    if p.attraction != 0.0:
        # strongest at `attraction_reach`, and fading beyond: no cable
        gap_x, gap_y = (p.attraction_x - x) / p.attraction_reach, (p.attraction_y - y) / p.attraction_reach
        hold = 2.0 * p.attraction / (1.0 + gap_x * gap_x + gap_y * gap_y)
        world_x, world_y = world_x + hold * gap_x, world_y + hold * gap_y
    if p.floor_sway != 0.0:
        sway = p.floor_sway * math.sin(2.0 * math.pi * time / SWAY_S)
        world_x, world_y = world_x + 0.8 * sway, world_y + 0.6 * sway
    return world_x, world_y


@njit
def load_reaction(offset: float, rate: float, p: Plant) -> float:
    """Force (N) of a load on springs on the car that carries it, at its `offset` (m) and its `rate` (m/s)."""
    return p.swinging_load * p.mass * (LOAD_RADPS**2 * offset + 2.0 * LOAD_DAMPING * LOAD_RADPS * rate)


@njit
def load_acceleration(offset: float, rate: float, carried: float) -> float:
    """Acceleration (m/s^2) of a load on springs against the car, which itself is accelerated by `carried` (m/s^2)."""
    return -carried - LOAD_RADPS**2 * offset - 2.0 * LOAD_DAMPING * LOAD_RADPS * rate

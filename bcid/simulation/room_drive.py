"""One drive of a small car in a room: commands at a rate and a phase of their own, driver, plant and motion capture."""

import math

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import ROUGHNESS_TIME_S, SAME_TIME_S, TRUTH_HZ, Drive, capture_poses, sample_truth
from bcid.simulation.driver import SimulatedArena
from bcid.simulation.dynamics import STATE_SIZE, STEPS_PER_S, advance_plant
from bcid.simulation.handling import Handling
from bcid.simulation.other_laws import two_sided_angle
from bcid.simulation.room_drivers import DRAWS, DRIVERS, MEMORY, decide
from bcid.simulation.wheels import PlantInputs

ROOM = SimulatedArena(length=6.0, width=4.4, margin=0.55)
"""A room with motion capture for small cars, m."""

CORNERING = 1.25  # times the drag on a straight
WIDER = 1.25  # wheelbase with which a driver reckons, as some cars turn less to one side
LOCK_SHARE = 0.97  # of the servo's range that drivers use
TURNED_SHARE = 0.4  # of it in usual corners, where a steered wheel's dry drag counts


@njit
def _acting_row(command_s: Floats, count: int, now: float, delay: float, row: int) -> tuple[int, float]:
    """Row of the command that acts at `now` (s) after a `delay` (s), and the time (s) at which the next one does.

    Of `command_s` (M,) the first `count` times count; the search begins at `row`, which has acted before.
    """
    while row + 1 < count and command_s[row + 1] + delay <= now + SAME_TIME_S:
        row += 1
    return row, command_s[row + 1] + delay if row + 1 < count else 1e18


@njit
def _drive_in_room(
    p: Plant, h: Handling, room: SimulatedArena, driver: int, start: Floats, duration: float, command_s: Floats,
    uniform: Floats, normal: Floats,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Plant states (S + 1, STATE_SIZE) at STEPS_PER_S from rest at `start` (x, y, yaw), and commands (M, 2).

    The driver decides at each of `command_s` (M,) (s), by the rows of `uniform` (M, DRAWS); the first is
    given before the drive begins.  The rows of `normal` (S, 3) drive the floor's random force and moment.
    """
    states = np.zeros((len(normal) + 1, STATE_SIZE))
    commands, mine = np.zeros((len(command_s), 2)), np.zeros(MEMORY)
    states[0, :3] = start
    step = command_s[1] - command_s[0]
    commands[0] = decide(driver, states[0], mine, uniform[0], 0.0, step, p, h, room)
    # the servo has come to rest at the first command, which was given before the take
    states[0, 6] = states[0, 7] = commands[0, 0]
    s, play, decided, steer_row, drive_row = states[0].copy(), commands[0, 0], 1, 0, 0
    push, keep = np.zeros(3), math.exp(-1.0 / (STEPS_PER_S * ROUGHNESS_TIME_S))
    fresh = math.sqrt(1.0 - keep * keep)
    for k in range(len(normal)):
        now, end = k / STEPS_PER_S, (k + 1) / STEPS_PER_S
        push = keep * push + fresh * normal[k]
        while end - now > SAME_TIME_S:
            while decided < len(command_s) and command_s[decided] <= now + SAME_TIME_S:
                commands[decided] = decide(driver, s, mine, uniform[decided], now, step, p, h, room)
                decided += 1
            steer_row, steer_until = _acting_row(command_s, decided, now, p.steering_delay, steer_row)
            drive_row, drive_until = _acting_row(command_s, decided, now, p.motor_delay, drive_row)
            until = min(end, steer_until, drive_until)
            if decided < len(command_s):
                until = min(until, command_s[decided])
            inputs = PlantInputs(
                now, duration, commands[steer_row, 0], commands[drive_row, 1],
                p.rough_force * push[0], p.rough_force * push[1], p.rough_moment * push[2],
            )  # fmt: skip
            s, play = advance_plant(s, play, inputs, until - now, p)
            now = until
        states[k + 1] = s
    return states, commands


def throttle_at_speed(p: Plant, speed: float) -> float:
    """Throttle (share) at which a force-law car `p` keeps a `speed` (m/s) in usual corners, which slow it down."""
    resist = p.rolling_drag * speed + p.rolling_drag_2 * speed**2 + p.rear_rolling_coulomb + p.motor_fade * speed
    resist += TURNED_SHARE * p.angle_limit * p.dry_steered_drag
    return p.motor_dead_zone + CORNERING * resist / (p.throttle_force - p.pulsed_fade * speed)


def handle_car(p: Plant, slow: float, fast: float, pace: float, rhythm: float) -> Handling:
    """How a force-law car `p` is handled between two speeds (m/s) by a driver of a `pace` and a `rhythm` (0 to 1)."""
    reckoned = WIDER * (p.front_lever + p.rear_lever)
    if min(p.left_reach, p.right_reach) > 0.0:  # it turns less at full lock than its servo says
        reach = min(p.left_reach, p.right_reach)
        reckoned *= p.angle_limit / two_sided_angle(p.angle_limit, 0.0, reach, reach)
    return Handling(
        slow, fast, throttle_at_speed(p, slow), throttle_at_speed(p, fast), LOCK_SHARE * p.angle_limit,
        reckoned, 0.7 * (p.front_grip + p.rear_grip) / p.mass, pace, rhythm,
    )  # fmt: skip


def simulate_room_drive(
    plant: Plant, sensor: Sensor, duration: float, seed: int, driver: str, speeds: tuple[float, float],
    command_hz: float, room: SimulatedArena = ROOM,
) -> Drive:  # fmt: skip
    """Simulate a drive of a force-law car in a `room` of `duration` seconds, from rest near its middle.

    Args:
        plant: the car.
        sensor: the motion capture.
        duration: length of the take, s.
        seed: of the driver, of the commands' phase against the poses, of the floor and of the noise.
        driver: one of DRIVERS.
        speeds: slow and fast speed, m/s, between which it is driven.
        command_hz: rate of the commands; the first is given up to one period before the first pose.
        room: in which it is driven.
    """
    rng = np.random.default_rng(seed)
    phase, pace, rhythm = rng.random(3)
    command_s = (np.arange(math.floor(duration * command_hz) + 1) - phase) / command_hz
    start = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(-np.pi, np.pi)])
    uniform = rng.random((len(command_s), DRAWS))
    normal = rng.standard_normal((round(duration * STEPS_PER_S), 3))
    handling = handle_car(plant, *speeds, 0.7 + 0.3 * float(pace), float(rhythm))
    states, commands = _drive_in_room(
        plant, handling, room, DRIVERS.index(driver), start, duration, command_s, uniform, normal
    )
    frame, pose = capture_poses(states, sensor, duration, rng)
    rows = np.arange(0, len(states), STEPS_PER_S // TRUTH_HZ)
    return Drive(command_s, commands, frame, pose, sample_truth(states[rows], rows / STEPS_PER_S))

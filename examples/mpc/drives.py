"""One drive: observer, plans and car in a closed loop, each command sent one period after what it was planned from."""

import time
from typing import NamedTuple, Protocol

import numpy as np
import scene
from observer import Observer
from problem import ParkingProblem, Plan


class Car(Protocol):
    """What can be driven: the simulated car, or a model in its place."""

    pose: np.ndarray
    speed: float
    servo_angle: float

    def measure_pose(self) -> np.ndarray:
        """The pose (3,) as it is seen."""

    def advance(self, u: np.ndarray, seconds: float) -> None:
        """Drive on under the command `u` (2,)."""


class ParkingDrive(NamedTuple):
    """What happened: rows are periods of the model, K + 1 poses around K commands."""

    pose: np.ndarray  # (K + 1, 3) true
    seen: np.ndarray  # (K + 1, 3) measured
    speed: np.ndarray  # (K + 1,) m/s
    servo: np.ndarray  # (K + 1,) rad
    command: np.ndarray  # (K, 2)
    plans: list[Plan]  # one for each command that was planned, as it was then
    plan_s: np.ndarray  # processor time in s of each plan but the first, which is made while the car stands
    parked: bool


def is_parked(car: Car) -> bool:
    """Whether a car stands at the goal, within scene.TOLERANCE."""
    distance, turn = scene.goal_errors(car.pose)
    limit = scene.TOLERANCE
    return distance <= limit.position and turn <= limit.heading and car.speed <= limit.speed


def drive(problem: ParkingProblem, car: Car, time_limit_s: float = scene.TIME_LIMIT_S) -> ParkingDrive:
    """Park the car by plans over the problem's model, or try until `time_limit_s` is over."""
    model = problem.model
    seen = [car.measure_pose()]
    observer = Observer(model, seen[0])
    poses, speeds, servo, commands, plans, plan_s = [car.pose], [car.speed], [car.servo_angle], [], [], []
    u = np.zeros(2)
    while not (parked := is_parked(car)) and len(commands) * model.period_s < time_limit_s:
        # while this command acts, the next one is planned from where the car will then be
        z_then = np.asarray(problem.block(observer.z, u)).ravel()
        begun = time.process_time()
        plans.append(problem.go_on(plans[-1], z_then, u) if plans else problem.begin(z_then, u))
        plan_s.append(time.process_time() - begun)
        for _ in range(problem.settings.hold):
            car.advance(u, model.period_s)
            observer.predict(u)
            seen.append(car.measure_pose())
            observer.update(seen[-1])
            poses.append(car.pose)
            speeds.append(car.speed)
            servo.append(car.servo_angle)
            commands.append(u)
            if is_parked(car):
                break
        u = plans[-1].u[:, 0]
    return ParkingDrive(
        np.array(poses), np.array(seen), np.array(speeds), np.array(servo), np.array(commands), plans,
        np.array(plan_s[1:]), parked,
    )  # fmt: skip

"""What a model itself makes of 200 commands: that by which every export of it is checked, here and at its user's."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.evaluation.validity import DataRange
from bcid.export.formulas import StepFormulas
from bcid.models.interface import History, Model, RolloutDiverged, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.augmented_step import N_MOTION
from bcid.physics.kinematics import kinematic_state

STEPS = 200
AT = N_MOTION - 1
"""Place of the time in the carry of a car with effects."""
HELD_STEPS = 7
"""Periods for which a command stays: as many as no delay is."""

EXACT, SINGLE = 1e-9, 1e-6
"""Largest error of a twist (m/s, rad/s) of an export: of formulas in double, of networks in single precision."""

START_TWIST, START_STEER_RAD = (0.5, 0.02, 0.1), 0.1
UNKNOWN_RANGE = ((-0.3, 0.3), (0.0, 1.0))
"""Commands (rad; throttle) between which a model is driven of whose data nothing is known."""


class ReferenceDrive(NamedTuple):
    """A drive of the model: where it starts, its commands, and the twists after each.

    Formulas in double precision are driven from the start to the end; a network, whose single precision each
    implementation rounds in its own way, from the model's own state in every step.
    """

    pose: Floats  # (3,)
    twist: Floats  # (3,)
    delta: float
    commands: Floats  # (STEPS, 2)
    twists: Floats  # (STEPS, 3)
    states: Floats | None  # (STEPS, n) before each command, of a model with a network
    tolerance: float  # m/s, rad/s


def drive_for_reference(
    model: Model, formulas: StepFormulas, limits: DataRange | None, time_s: float | None = None, seed: int = 1
) -> ReferenceDrive:
    """Drive `model` by commands drawn from the middle half of its data's range, each held for a few periods.

    Raises:
        InputRefused: the model leaves the finite numbers; no export of it can be checked.
    """
    rng = np.random.default_rng(seed)
    low, high = (
        np.array(UNKNOWN_RANGE).T if limits is None else (np.array(end[-2:]) for end in (limits.low, limits.high))
    )
    drawn = rng.uniform(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high, (-(-STEPS // HELD_STEPS), 2))
    commands = np.repeat(drawn, HELD_STEPS, axis=0)[:STEPS]
    pose, twist = np.zeros(3), np.array(START_TWIST)
    history = _history(model, pose, twist, START_STEER_RAD)
    try:
        twists = (
            rollout(model, history, commands)[1:] if time_s is None else _drive_at(model, history, commands, time_s)
        )
    except RolloutDiverged as error:
        raise InputRefused(model.name, "model", f"{error} as it is driven for a check", "fit it to more data") from None
    states = _states(model, history, commands) if formulas.networks else None
    return ReferenceDrive(
        pose, twist, START_STEER_RAD, commands, twists, states, SINGLE if formulas.networks else EXACT
    )


def _history(model: Model, pose: Floats, twist: Floats, delta: float) -> History:
    """The past motion of a vehicle of which only pose, twist and steering angle (rad) are known."""
    rows, car = model.lags + 1, getattr(model, "car", None)
    v_x, v_y, yaw_rate = twist
    slips = kinematic_state(v_x, v_y, yaw_rate, delta, car.l_f, car.l_r) if car is not None else (0.0, 0.0, 0.0)
    return History(
        np.tile(twist, (rows, 1)), np.tile([*slips, delta], (rows, 1)), np.zeros((rows - 1, 1, 4)),
        np.tile(pose, (rows, 1)), np.zeros(rows),
    )  # fmt: skip


def _drive_at(model: Model, history: History, commands: Floats, time_s: float) -> Floats:
    """Twists (N, 3) after each of `commands` (N, 2) of a car with effects for which it is always `time_s` (s)."""
    if not isinstance(model, AugmentedNewtonEuler):
        return rollout(model, history, commands)[1:]
    carry, twists = model.init(history), []
    given = slice(N_MOTION, None, 4)  # the times of the commands that the carry holds
    carry[given] += time_s - carry[AT]
    for command in commands:
        carry[AT] = time_s
        carry, twist = model.step(carry, command)
        carry[given] -= model.period_s
        twists.append(twist)
    return np.array(twists)


def _states(model: Model, history: History, commands: Floats) -> Floats:
    """The model's own states before each of `commands` (N, 2): (N, n)."""
    carry, states = model.init(history), []
    for command in commands:
        states.append(np.array(carry))
        carry, _ = model.step(carry, command)
    return np.array(states)

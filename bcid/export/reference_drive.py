"""What a model itself makes of 200 commands, of single periods and of first states.

By these every export of it is checked, here and at its user's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.evaluation.closed_loop import integrate_poses
from bcid.evaluation.validity import DataRange
from bcid.export.formulas import StepFormulas
from bcid.export.reference_steps import ReferenceSteps, single_steps, state_of
from bcid.export.start import slips_at_start
from bcid.models.interface import History, Model, RolloutDiverged, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.augmented_step import N_MOTION

STEPS = 200
AT = N_MOTION - 1
"""Place of the time in the carry of a car with effects."""
HELD_STEPS = 7
"""Periods for which a command stays: as many as no delay is."""

EXACT, SINGLE = 1e-9, 1e-6
"""Largest error of a twist (m/s, rad/s) of an export: of formulas in double, of networks in single precision."""

EXACT_STEP, SINGLE_STEP = 1e-10, 1e-5
"""Largest error of a number of a state or twist after one period from a drawn state; the former also of first states.

It is relative for numbers beyond 1, and for forces, sums of larger ones, beyond the largest.  States are drawn beyond
the data, where networks round more than in it.
"""
ROUNDED_FROM_S = 100.0
"""Time of the recording (s) from which on the model's own rounding of when commands come allows more."""

START_TWIST, START_STEER_RAD = (0.5, 0.02, 0.1), 0.1
OTHER_STARTS = (
    ((3.0, -1.0, 0.4), (0.8, 0.1, -0.2), 0.15),
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0),
)
"""Pose, twist and steering angle of further first states: elsewhere, and at rest."""
UNKNOWN_RANGE = ((-0.3, 0.3), (0.0, 1.0))
"""Commands (rad; throttle) between which a model is driven of whose data nothing is known."""


class FirstState(NamedTuple):
    """The model's own first state at a pose (3,), a twist (3,) and a steering angle (rad), its past not known."""

    pose: Floats
    twist: Floats
    delta: float
    state: Floats  # (n,)


class ReferenceDrive(NamedTuple):
    """A drive of the model: where it starts, its commands, and the twists after each; single periods; first states.

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
    end_pose: Floats  # (3,) after the last command
    steps: ReferenceSteps
    step_tolerance: float  # of single periods; relative for numbers beyond `scales`, of a twist beyond 1
    starts: tuple[FirstState, ...]  # the first is that of the drive
    scales: Floats  # (n,) of a state: errors are relative for numbers beyond these


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
    history = history_of_start(model, pose, twist, START_STEER_RAD, time_s)
    try:
        if time_s is not None and isinstance(model, AugmentedNewtonEuler):
            twists = _drive_at(model, history, commands, time_s)
        else:
            twists = rollout(model, history, commands)[1:]
    except RolloutDiverged as error:
        raise InputRefused(model.name, "model", f"{error} as it is driven for a check", "fit it to more data") from None
    states = _states(model, history, commands) if formulas.networks else None
    end_pose = integrate_poses(pose, np.vstack([twist, twists]), model.period_s)[-1]
    steps = single_steps(model, formulas, limits, time_s, rng)
    if not len(steps.states):
        raise InputRefused(model.name, "model", "diverges in every single period of a check", "fit it to more data")
    starts = tuple(
        _first_state(model, formulas, np.array(p), np.array(v), delta, time_s)
        for p, v, delta in ((pose, twist, START_STEER_RAD), *OTHER_STARTS)
    )
    exact_step = EXACT_STEP * max(1.0, (time_s or 0.0) / ROUNDED_FROM_S)
    tolerance, step_tolerance = (SINGLE, SINGLE_STEP) if formulas.networks else (EXACT, exact_step)
    return ReferenceDrive(
        pose, twist, START_STEER_RAD, commands, twists, states, tolerance, end_pose, steps, step_tolerance, starts,
        _scales(formulas, steps),
    )  # fmt: skip


def _scales(formulas: StepFormulas, steps: ReferenceSteps) -> Floats:
    """Beyond which errors of the numbers of a state (n,) are relative: 1, and of a force the largest."""
    is_force = [q.unit == "N" for q in formulas.states]
    return np.where(is_force, np.maximum(1.0, np.abs(steps.next_states).max(axis=0)), 1.0)


def history_of_start(model: Model, pose: Floats, twist: Floats, delta: float, time_s: float | None = None) -> History:
    """The past motion of a vehicle of which only pose, twist and steering angle (rad) are known, at `time_s` (s)."""
    rows, car = model.lags + 1, getattr(model, "car", None)
    v_x, v_y, yaw_rate = twist.tolist()
    slips = slips_at_start(v_x, v_y, yaw_rate, delta, car.l_f, car.l_r) if car is not None else (0.0, 0.0, 0.0)
    return History(
        np.tile(twist, (rows, 1)), np.tile([*slips, delta], (rows, 1)),
        np.tile([model.period_s, delta, 0.0, 0.0], (rows - 1, 1, 1)), np.tile(pose, (rows, 1)),
        np.full(rows, 0.0 if time_s is None else time_s),
    )  # fmt: skip


def _first_state(
    model: Model, formulas: StepFormulas, pose: Floats, twist: Floats, delta: float, time_s: float | None
) -> FirstState:
    """The model's own first state at `pose`, `twist` and steering angle `delta` (rad)."""
    carry = model.init(history_of_start(model, pose, twist, delta, time_s))
    return FirstState(pose, twist, delta, state_of(model, [q.name for q in formulas.states], carry))


def _drive_at(model: AugmentedNewtonEuler, history: History, commands: Floats, time_s: float) -> Floats:
    """Twists (N, 3) after each of `commands` (N, 2) of a car with effects for which it is always `time_s` (s)."""
    carry, twists = model.init(history), []
    given = slice(N_MOTION, None, 4)  # the times of the commands that the carry holds
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

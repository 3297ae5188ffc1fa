"""Single periods of a model from drawn states: where a drive from a gentle start never comes.

Among them are a vehicle at rest, in reverse, under the brake, at full lock, skidding, and, but for networks, far faster
than any data.  Whatever constant a formula holds, it acts in some of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.evaluation.validity import QUANTITIES, DataRange
from bcid.export.formulas import COMMANDS, StepFormulas
from bcid.models.interface import Model
from bcid.models.limits import LIMITS
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.augmented_step import N_MOTION

EACH = 24
"""Rows that are drawn of each kind."""
BEYOND_DATA, NEAR_REST, FAR_BEYOND = 1.3, 0.1, 4.0
"""How far states and commands are drawn, as a multiple of the largest in the data."""

UNKNOWN_REACH = {"v_x": 1.5, "v_y": 0.4, "yaw_rate": 1.5, "u_s": 0.4, "u_m": 1.0}
"""Largest twists (m/s, rad/s) and commands (rad; throttle) of a model of whose data nothing is known."""
LATEST_S = 60.0
"""Time of the recording (s): the later, the more the model itself rounds when commands come."""
OTHER_REACH, SLIP_REACH_RAD = {"p_x": 2.0, "p_y": 2.0, "theta": math.pi, "F_mf": 100.0, "F_mr": 100.0}, 0.4
"""Largest poses (m, rad) and lagging forces (N), and slip angles."""

CARRY = (
    "p_x", "p_y", "theta", "v_x", "v_y", "yaw_rate", "alpha_f", "F_mf", "F_mr", "delta", "delta_lagged",
    "delta_behind", "t",
)  # fmt: skip
"""The exported names of the numbers in the carry of a car with effects, before its commands."""


class ReferenceSteps(NamedTuple):
    """What a model makes of M states in one period, each under a command of its own."""

    states: Floats  # (M, n)
    commands: Floats  # (M, 2)
    next_states: Floats  # (M, n)
    twists: Floats  # (M, 3) after the period


def single_steps(
    model: Model, formulas: StepFormulas, limits: DataRange | None, time_s: float | None, rng: np.random.Generator
) -> ReferenceSteps:
    """About a hundred single periods of `model`, those left out after which a rollout would have diverged.

    States are drawn to beyond the range of the data, `limits`.  Effects of the recording's time stand at `time_s` (s),
    where that is given.
    """
    names = [quantity.name for quantity in formulas.states]
    table = _draw([*names, *(c.name for c in COMMANDS)], model, limits, bool(formulas.networks), rng)
    rows = []
    for row in table:
        state, command = row[: len(names)], row[len(names) :]
        carry, twist = model.step(carry_of(model, names, state, time_s), command)
        rows.append((state, command, state_of(model, names, carry), twist))
    steps = ReferenceSteps(*(np.array(column) for column in zip(*rows, strict=True)))
    kept = (np.abs(steps.twists) <= LIMITS.fastest_twist).all(axis=1) & np.isfinite(steps.next_states).all(axis=1)
    return ReferenceSteps(*(column[kept] for column in steps))


def carry_of(model: Model, names: Sequence[str], state: Floats, time_s: float | None) -> Floats:
    """The carry of `model` at the exported `state`, whose numbers are called `names`.

    A car with effects keeps commands with their times, here whole periods before its own time, `time_s` (s) where its
    state has none.  What its state leaves out never acts, and the steering is behind nothing.
    """
    if not isinstance(model, AugmentedNewtonEuler):
        return state.copy()
    known = dict(zip(names, state.tolist(), strict=True))
    known.setdefault("t", 0.0 if time_s is None else time_s)
    known.setdefault("delta_lagged", known.get("delta", 0.0))
    known.setdefault("delta_behind", known["delta_lagged"])
    # commands older than those that the state holds never act
    oldest = max([0, *(int(name.rpartition("_")[2]) for name in names if "_ago_" in name)])
    kept = [
        [known["t"] - k * model.period_s, *(known.get(f"{c.name}_ago_{min(k, oldest)}", 0.0) for c in COMMANDS), 0.0]
        for k in range(model.setup.kept, 0, -1)
    ]
    return np.array([*(known.get(name, 0.0) for name in CARRY), *np.ravel(kept)])


def state_of(model: Model, names: Sequence[str], carry: Floats) -> Floats:
    """The exported state, whose numbers are called `names`, in a `carry` of `model`; undoes `carry_of`."""
    if not isinstance(model, AugmentedNewtonEuler):
        return np.array(carry)
    known = dict(zip(CARRY, carry, strict=False))
    for k, (_, *commands, _) in enumerate(reversed(carry[N_MOTION:].reshape(-1, 4).tolist()), start=1):
        known |= {f"{c.name}_ago_{k}": value for c, value in zip(COMMANDS, commands, strict=True)}
    return np.array([known[name] for name in names])


def _draw(
    names: Sequence[str], model: Model, limits: DataRange | None, is_network: bool, rng: np.random.Generator
) -> Floats:
    """Drawn rows (M, n) of the quantities called `names`, first some of a vehicle at rest."""
    reach, n = np.array([_reach(name, model, limits) for name in names]), len(names)
    stretches = [BEYOND_DATA, BEYOND_DATA, NEAR_REST, BEYOND_DATA if is_network else FAR_BEYOND]
    drawn = [stretch * reach * rng.uniform(-1.0, 1.0, (EACH, n)) for stretch in stretches]
    table = np.vstack([_at_rest(names, reach), *drawn])
    for i, name in enumerate(names):
        if name == "v_f":
            table[:, i] = np.abs(table[:, i])
        elif name == "t":
            table[:, i] = np.abs(table[:, i]) % reach[i]
        elif name == "v_x":
            table[-EACH:, i] = np.abs(table[-EACH:, i])  # the fastest go ahead
    return table


def _at_rest(names: Sequence[str], reach: Floats) -> Floats:
    """A vehicle at rest under no command, and under each command to either side (5, n)."""
    table = np.zeros((1 + 2 * len(COMMANDS), len(names)))
    for i, command in enumerate(COMMANDS):
        place = names.index(command.name)
        table[1 + 2 * i, place], table[2 + 2 * i, place] = reach[place], -reach[place]
    return table


def _reach(name: str, model: Model, limits: DataRange | None) -> float:
    """The largest size of the quantity called `name`, over the data or one that a vehicle of such data may have."""
    stem = name.partition("_ago_")[0]
    if stem in UNKNOWN_REACH:
        if limits is None:
            return UNKNOWN_REACH[stem]
        place = list(QUANTITIES).index(stem)
        return max(abs(limits.low[place]), abs(limits.high[place]), NEAR_REST * UNKNOWN_REACH[stem])
    if stem.startswith("delta"):
        return _reach("u_s", model, limits)
    if stem == "v_f":
        return _reach("v_x", model, limits)
    if stem == "t":
        return min(float(getattr(model, "recording_s", LATEST_S)), LATEST_S)
    return OTHER_REACH.get(stem, SLIP_REACH_RAD)

"""What is known of a vehicle where a prediction starts: a state given as numbers, or a moment of a recording.

A start's uncertainty is a list of independent errors, each a standard deviation long, of pose [x, y, yaw], twist
[v_x, v_y, yaw rate] and kinematic state [v_f, alpha_f, alpha_r, delta]: models that begin with the twist take no notice
of the slip angles, and models that begin with these none of the twist.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused, UsageError
from bcid.estimate.types import Estimate
from bcid.models.interface import History, Model, history_at
from bcid.physics.kinematics import kinematic_state
from bcid.prediction.limits import LIMITS


@dataclass(frozen=True)
class State:
    """A state of the vehicle at its tracked point: pose, twist and steering angle; what is not given is zero.

    `sd` holds standard deviations by the names of the other fields; those that it lacks are known exactly.
    """

    x: float = 0.0  # m, world
    y: float = 0.0  # m, world
    yaw: float = 0.0  # rad
    v_x: float = 0.0  # m/s, forward
    v_y: float = 0.0  # m/s, to the left
    yaw_rate: float = 0.0  # rad/s
    delta: float = 0.0  # rad, of the front wheels
    sd: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse numbers that are not finite, and standard deviations that are negative or of nothing."""
        for name in STATE_NAMES:
            if not math.isfinite(getattr(self, name)):
                raise UsageError(f"state: {name} is {getattr(self, name)}\n  next: give a finite number")
        for name, value in self.sd.items():
            if name not in STATE_NAMES:
                raise UsageError(f"state: there is no {name!r}\n  next: choose of {', '.join(STATE_NAMES)}")
            if not (math.isfinite(value) and value >= 0.0):
                raise UsageError(f"state: the standard deviation of {name} is {value}\n  next: give one from zero on")

    @classmethod
    def parse(cls, text: str, sd: str = "") -> State:
        """The state in a text such as "x=1.2,v_x=0.8", with standard deviations in a second one of the same form.

        Raises:
            UsageError: a part of a text is no NAME=NUMBER, or its name is none of a state's.

        >>> State.parse("v_x=1.5, delta=0.1", "v_x=0.02").sd
        {'v_x': 0.02}
        """
        return cls(**_parse_numbers(text, "--state"), sd=_parse_numbers(sd, "--sd"))

    @property
    def pose(self) -> Floats:
        """The pose [x (m), y (m), yaw (rad)]."""
        return np.array([self.x, self.y, self.yaw])

    @property
    def twist(self) -> Floats:
        """The twist [v_x (m/s), v_y (m/s), yaw rate (rad/s)]."""
        return np.array([self.v_x, self.v_y, self.yaw_rate])


STATE_NAMES = tuple(f.name for f in fields(State) if f.name != "sd")
"""The names of a state's numbers."""


@dataclass(frozen=True)
class Moment:
    """A time (s, of the take) in an estimated recording, from which a prediction starts."""

    estimate: Estimate
    time_s: float


@dataclass(frozen=True)
class InitialState:
    """The past motion that a prediction starts from, the errors of its last row, and the time of that row."""

    history: History
    spread: Floats  # (m, 10) independent errors, one standard deviation each: pose, twist, kinematic state
    time_s: float

    @property
    def steering_angle(self) -> float:
        """The angle (rad) of the front wheels from which the prediction starts."""
        return float(self.history.kinematic[-1, 3])

    def shift(self, error: Floats) -> History:
        """The history with all rows shifted by an `error` (10,) of pose, twist and kinematic state.

        Estimated rows that follow each other are off by nearly the same.
        """
        h = self.history
        return replace(h, pose=h.pose + error[:3], twist=h.twist + error[3:6], kinematic=h.kinematic + error[6:])


def start_from_state(state: State, model: Model, first_command: Floats) -> InitialState:
    """The start at a given state, of which nothing earlier is known; its time is zero.

    A model that remembers has always been in this state, under the `first_command` [u_s (rad), u_m].
    """
    n = model.lags + 1
    kinematic = _kinematic_row(state, model)
    parts = np.zeros((model.lags, 1, 4))
    parts[:, 0, 1:3] = first_command
    history = History(
        np.tile(state.twist, (n, 1)), np.tile(kinematic, (n, 1)), parts, np.tile(state.pose, (n, 1)), np.zeros(n)
    )
    errors = [_error_of_state(state, name, model) for name in STATE_NAMES if state.sd.get(name, 0.0) > 0.0]
    return InitialState(history, np.array(errors).reshape(-1, 10), 0.0)


def _error_of_state(state: State, name: str, model: Model) -> Floats:
    """The error (10,) of pose, twist and kinematic state that one standard deviation of the state's `name` makes."""
    above, below = (replace(state, **{name: getattr(state, name) + sign * state.sd[name]}) for sign in (1.0, -1.0))
    ends = [np.concatenate([s.pose, s.twist, _kinematic_row(s, model)]) for s in (above, below)]
    return np.asarray(0.5 * (ends[0] - ends[1]))


def _kinematic_row(state: State, model: Model) -> Floats:
    """The kinematic state [v_f (m/s), alpha_f, alpha_r, delta (rad)] at a given state of the vehicle of a model.

    A model without a car has no levers; it does not look at slip angles either, and they are zero.
    """
    car = getattr(model, "car", None)
    if car is None:
        return np.array([0.0, 0.0, 0.0, state.delta])
    angles = kinematic_state(state.v_x, state.v_y, state.yaw_rate, state.delta, car.l_f, car.l_r)
    return np.array([*angles, state.delta])


def find_row(moment: Moment, period_s: float) -> int:
    """The estimate's row that is next to a moment, for a model that advances by `period_s` (s).

    Raises:
        InputRefused: no row is within half a period of the moment, or the estimate has another period.
    """
    e, at = moment.estimate, moment.time_s
    if abs(e.period_s - period_s) > LIMITS.max_period_difference_s:
        cause = f"is estimated every {e.period_s:g} s, and the model steps by {period_s:g} s"
        raise InputRefused(e.name, "period_s", cause, f"estimate it with period_s = {period_s:g}")
    row = int(np.argmin(np.abs(e.time_s - at)))
    if not abs(e.time_s[row] - at) <= 0.5 * e.period_s + 1e-9:
        parts = "; ".join(f"{e.time_s[s.start]:.2f} to {e.time_s[s.stop - 1]:.2f} s" for s in e.segments())
        raise InputRefused(e.name, f"{at:g} s", f"the motion is known from {parts}", "choose a moment in there")
    return row


def start_from_row(estimate: Estimate, row: int, lags: int) -> InitialState:
    """The start at a row of an estimate, whose smoother knows the poses before and after it.

    Errors of the pose are taken as those of a single tracked pose, which the smoother does not exceed; those of twist,
    slip angles and steering are the smoother's, and independent of each other.
    """
    noise = estimate.tuning.noise if estimate.tuning else None
    pose_sd = (noise.r_position, noise.r_position, noise.r_yaw) if noise else (0.0, 0.0, 0.0)
    sd = np.concatenate([pose_sd, estimate.twist_sd[row], estimate.kinematic_sd[row]])
    return InitialState(history_at(estimate, row, lags), np.diag(sd), float(estimate.time_s[row]))


def _parse_numbers(text: str, option: str) -> dict[str, float]:
    """Numbers by name, from a text such as "x=1.2,v_x=0.8".

    Raises:
        UsageError: a part is no NAME=NUMBER, a name stands twice, or a state has none of it.
    """
    numbers = dict[str, float]()
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name not in STATE_NAMES or name in numbers:
            raise UsageError(f"{option}: {part!r}\n  next: give each of {', '.join(STATE_NAMES)} once at most")
        try:
            numbers[name] = float(value)
        except ValueError:
            raise UsageError(f"{option}: {part!r}\n  next: write NAME=NUMBER, such as v_x=1.5") from None
    return numbers

"""The functions of a remainder: half waves of what a drive went through, alone and in pairs, in every channel.

A quantity that ranged over [c - h, c + h] enters as cos(pi a (s - c + h) / (2 h)), a = 1, 2, ...: the cosines that are
orthogonal over the range.  Two of them are multiplied by their sums and differences, cos A cos B being half of
cos(A + B) + cos(A - B).  Coefficients of fine functions are expected to be smaller, by 1 / (1 + a^2 + b^2): what is
smooth is likelier.  No function is a law of the vocabulary.
"""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, Self

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.effects.harmonics import NO_HALF_WAVES, plan_angles
from bcid.effects.remainder_table import COLUMNS, DIRECTION, DIRECTIONS, INPUTS, OF_THE_CAR, PHASE, WAVE
from bcid.likelihood.tracking_functions import (
    FIRST_WAVE,
    INTO,
    SHIFT,
    TRACKING_COLUMNS,
    TRACKING_DIRECTIONS,
    TRACKING_INPUTS,
)
from bcid.likelihood.unnamed_functions import RemainderFunctions
from bcid.physics.car import Car

TURN_RAD = 0.1
"""A change of the wheel's angle that counts as much as 1 m/s^2 in the prior's common size."""

SEEN_SIZE = 0.1
"""An error of the tracking (m, rad, s) that counts as much."""

QUANTITIES = {
    "v_x": "v_x", "omega": "yaw_rate", "v_fx": "v_x", "alpha_f": "alpha_f", "alpha_r": "alpha_r", "delta": "steering",
    "delta_rate": "steering_rate", "u_m": "throttle", "p_x": "place", "p_y": "place", "t": "time",
}  # fmt: skip
"""Names in diagnosis.json of what functions depend on."""

Waves = Mapping[str, float]
"""Half waves over the range of a quantity, by its name; a negative number turns the wave round."""

LINEAR = 0.01
"""A hundredth of a half wave, about its node: it is a straight line through the middle of the range."""


LEAST_HALF_WIDTH = 1e-3
"""Half of a range (m, m/s, rad, rad/s, s, 1) below which a quantity is as good as constant, and so are functions of it.
Over a narrower one they would turn by what predictions err."""


class Term(NamedTuple):
    """A function: its channel, the direction in which it acts, and its half waves."""

    channel: str
    direction: str
    waves: Waves


def channel_of(group: str) -> str:
    """The channel of a group of functions: its waves (~) and its constants (=) are its own."""
    return group.rstrip("~=")


def is_copy(group: str) -> bool:
    """Whether the functions of a group are copies of laws that have names (=)."""
    return group.endswith("=")


class RemainderBasis(NamedTuple):
    """All functions that a remainder may have, with the size to which each is expected to act."""

    functions: Floats  # (B, COLUMNS) on the body, with coefficients of zero
    tracking: Floats  # (M, TRACKING_COLUMNS) in the tracking, likewise
    channel: tuple[str, ...]  # (K,), K = B + M
    size: Floats  # (K,) of a coefficient, beside others of its channel (m/s^2, rad/s^2, rad, m, s)
    yaw_size: float = 1.0  # rad/s^2 that count as much as 1 m/s^2
    prices: Mapping[str, float] = MappingProxyType({})  # nats, by group, for functions that were chosen after the data
    half_waves: Floats = NO_HALF_WAVES  # (len(INPUTS), 2) phase and wave number of half a wave over each range

    @property
    def channels(self) -> tuple[str, ...]:
        """The groups of functions with one spread each: channels, their waves (~) and their constants (=)."""
        return tuple(dict.fromkeys(self.channel))

    def price(self, spread: Mapping[str, float]) -> float:
        """Nats that the choice of functions costs, of the groups that act by their `spread`."""
        return sum(nats for group, nats in self.prices.items() if spread[group] > 0.0)

    def groups(self, copied: Iterable[str]) -> tuple[str, ...]:
        """All groups, of copies of laws that have names those in the channels `copied` only."""
        return tuple(name for name in self.channels if not is_copy(name) or channel_of(name) in copied)

    def sd(self, spread: Mapping[str, float]) -> Floats:
        """Prior standard deviations (K,) of the coefficients, by the `spread` of each channel."""
        return np.asarray(self.size * np.array([spread[name] for name in self.channel]))

    def quantities(self) -> dict[str, Bools]:
        """Which functions (K,) depend on each quantity, by its name in diagnosis.json."""
        waves = {name: self.functions[:, WAVE + j] != 0.0 for j, name in enumerate(INPUTS)}
        seen = {name: self.tracking[:, FIRST_WAVE + j] != 0.0 for j, name in enumerate(TRACKING_INPUTS)}
        out = dict[str, Bools]()
        for name, body in waves.items():
            both = np.r_[body, seen.get(name, np.zeros(len(self.tracking), dtype=bool))]
            written = QUANTITIES[name]
            out[written] = out[written] | both if written in out else both
        return out

    def of_the_car(self) -> Self:
        """The functions on the body that depend on the car's own state alone, neither on the place nor on the time."""
        own = ~self.functions[:, WAVE + OF_THE_CAR :].any(axis=1)
        on = np.flatnonzero(own)
        return self._replace(
            functions=self.functions[on], tracking=self.tracking[:0], channel=tuple(self.channel[j] for j in on),
            size=self.size[on],
        )  # fmt: skip

    def choose(self, on: Ints, sd: Floats) -> RemainderFunctions:
        """The functions with the indices `on`, with prior standard deviations of `sd` (K,)."""
        B = len(self.functions)
        body, channel = self.functions[on[on < B]], tuple(self.channel[j] for j in on)
        plan = plan_angles(body, self.half_waves)
        return RemainderFunctions(body, self.tracking[on[on >= B] - B], channel, sd[on], plan)


def _alone(channel: str, direction: str, **most: int) -> Iterator[Term]:
    """Half waves of single quantities, from one up to so many of each."""
    for name, count in most.items():
        for a in range(1, count + 1):
            yield Term(channel, direction, {name: a})


def _together(channel: str, direction: str, first: str, second: str, *waves: tuple[int, int]) -> Iterator[Term]:
    """Products of half waves of two quantities, so many of each, as sums and differences."""
    for (a, b), sign in itertools.product(waves, (1, -1)):
        yield Term(channel, direction, {first: a, second: sign * b})


def _by_place(channel: str, direction: str, name: str, *waves: tuple[int, int]) -> Iterator[Term]:
    """Products of one half wave of a quantity and so many of the place's two coordinates."""
    for (a, b), x, y in itertools.product(waves, (1, -1), (1, -1)):
        yield Term(channel, direction, {name: 1, "p_x": x * a, "p_y": y * b})


CHANNELS = ("fx", "fy", "mz", "motor", "steering", "pose", "time")
"""All channels in which something without a name may act."""

LOW, MORE = ((1, 1),), ((1, 1), (2, 1), (1, 2))
TERMS: tuple[Term, ...] = (
    *_alone("fx", "body_x", v_x=8, p_x=3, p_y=3, t=4),
    *_together("fx", "body_x", "v_x", "omega", *LOW),
    *_together("fx", "body_x", "p_x", "p_y", *MORE),
    *_together("fx", "body_x", "v_x", "t", *MORE),
    *_alone("fx", "rolling", v_x=4, p_x=2, p_y=2, t=3),
    *_together("fx", "rolling", "p_x", "p_y", *LOW),
    *_together("fx", "rolling", "v_x", "t", *LOW),
    *_alone("fx", "front_along", v_fx=4, delta=6),
    *_together("fx", "front_along", "v_fx", "delta", *MORE, (2, 2), (1, 3), (1, 4), (1, 5), (1, 6)),
    *(t for d in ("world_x", "world_y") for t in _alone("fx", d, p_x=2, p_y=2)),
    *(t for d in ("world_x", "world_y") for t in _together("fx", d, "p_x", "p_y", *LOW)),
    *_alone("fy", "front_across", alpha_f=4, v_fx=2, t=2),
    *_together("fy", "front_across", "alpha_f", "v_fx", *LOW),
    *_together("fy", "front_across", "alpha_f", "u_m", *LOW),
    *_alone("fy", "front_across", delta_rate=4),
    *_together("fy", "front_across", "delta_rate", "v_fx", *MORE),
    *_together("fy", "front_across", "alpha_f", "t", *MORE),
    *_by_place("fy", "front_across", "alpha_f", (1, 1), (2, 2), (1, 2), (2, 1)),
    *_alone("fy", "rear_across", alpha_r=3, v_x=2),
    *_together("fy", "rear_across", "alpha_r", "t", *LOW),
    Term("mz", "yaw", {}),
    *_alone("mz", "yaw", omega=6, delta_rate=2, v_x=2, u_m=2, t=2),
    *_together("mz", "yaw", "omega", "v_x", *LOW),
    *_together("mz", "yaw", "omega", "t", *LOW),
    *_together("mz", "yaw", "u_m", "delta", *LOW),
    *_alone("motor", "driven_along", u_m=6),
    *_together("motor", "driven_along", "u_m", "v_fx", *MORE, (2, 2), (3, 1), (1, 3)),
    *_together("motor", "driven_along", "u_m", "t", *MORE),
    *_alone("steering", "wheel_angle", delta=6, delta_rate=6, t=3),
    *_together("steering", "wheel_angle", "delta", "delta_rate", *MORE, (2, 2)),
    *_together("steering", "wheel_angle", "delta", "v_x", *MORE),
    *_together("steering", "wheel_angle", "delta", "t", *LOW),
)
"""Smooth functions on the body.  Time and place are among what each may depend on: what changes slowly, or here and
there, is physics, too."""


SEEN: tuple[Term, ...] = (
    *(t for d in ("seen_x", "seen_y") for t in _alone("pose", d, p_x=3, p_y=3)),
    *(t for d in ("seen_x", "seen_y") for t in _together("pose", d, "p_x", "p_y", *LOW)),
    *(t for d in ("seen_along", "seen_across") for t in _alone("pose", d, t=2)),
    *(t for t in _alone("pose", "seen_yaw", p_x=2, p_y=2, t=2)),
    *(t for t in _alone("time", "seen_late", t=3)),
)
"""Smooth functions in the tracking."""

COPIES: tuple[Term, ...] = (
    Term("fx=", "body_x", {}), Term("fx=", "rolling", {}), Term("fx=", "front_along", {}), Term("fx=", "world_x", {}),
    Term("fx=", "world_y", {}), Term("fy=", "front_across", {}), Term("fy=", "rear_across", {}),
    Term("motor=", "driven_along", {}), Term("steering=", "wheel_angle", {}),
    Term("fx=", "body_x", {"v_x": LINEAR}), Term("mz=", "yaw", {"omega": LINEAR}),
    Term("steering=", "wheel_angle", {"delta": LINEAR}),
)  # fmt: skip
"""Constants and straight lines on the body: copies of laws that have names.  A name is weighed beside its copy only
where the channel is needed anyway, as else it could never win."""

SEEN_COPIES: tuple[Term, ...] = (
    Term("pose=", "seen_along", {}), Term("pose=", "seen_across", {}), Term("pose=", "seen_yaw", {}),
    Term("time=", "seen_late", {}), Term("pose=", "seen_x", {"p_x": LINEAR}), Term("pose=", "seen_y", {"p_y": LINEAR}),
)  # fmt: skip
"""Those in the tracking, likewise; an offset of the place is the world's."""


def remainder_basis(quantities: Mapping[str, Floats], car: Car) -> RemainderBasis:
    """The functions of a remainder for a drive that went through `quantities` (n,), by the names in INPUTS.

    The middle 98 % of a quantity count as its range, of place and time all.
    """
    ranges = {name: _range(name, quantities[name]) for name in INPUTS}
    per_turn = car.m * 0.5 * (car.l_f + car.l_r) / car.I_z  # rad/s^2 by a force of 1 m/s^2 at an axle
    size = {"yaw": per_turn, "wheel_angle": TURN_RAD} | dict.fromkeys(TRACKING_DIRECTIONS, SEEN_SIZE)
    on_body, in_tracking = (*TERMS, *COPIES), (*SEEN, *SEEN_COPIES)
    body, tracking = np.zeros((len(on_body), COLUMNS)), np.zeros((len(in_tracking), TRACKING_COLUMNS))
    body[:, DIRECTION] = [DIRECTIONS.index(t.direction) for t in on_body]
    tracking[:, INTO] = [TRACKING_DIRECTIONS.index(t.direction) for t in in_tracking]
    body[:, PHASE], body[:, WAVE:] = _phases_and_waves(on_body, INPUTS, ranges)
    tracking[:, SHIFT], tracking[:, FIRST_WAVE:] = _phases_and_waves(in_tracking, TRACKING_INPUTS, ranges)
    every = (*on_body, *in_tracking)
    sizes = [size.get(t.direction, 1.0) * _expected_size(t.waves) for t in every]
    each, waves = _phases_and_waves([Term("", "", {name: 1}) for name in INPUTS], INPUTS, ranges)
    half_waves = np.column_stack([each, np.diag(waves)])
    return RemainderBasis(
        body, tracking, tuple(t.channel for t in every), np.array(sizes), per_turn, half_waves=half_waves
    )


def _expected_size(waves: Waves) -> float:
    """To what size a function's coefficient is expected: fine waves are smaller; a straight line is 1 at both ends."""
    straight = 2.0 / (np.pi * LINEAR) if LINEAR in waves.values() else 1.0
    return straight / (1.0 + sum(a * a for a in waves.values()))


def _phases_and_waves(
    terms: Sequence[Term], inputs: Sequence[str], ranges: Mapping[str, tuple[float, float]]
) -> tuple[Floats, Floats]:
    """Phases (n,) and wave vectors (n, len(inputs)) of terms: half waves from one end of a range on."""
    phase, wave = np.zeros(len(terms)), np.zeros((len(terms), len(inputs)))
    for j, term in enumerate(terms):
        for name, a in term.waves.items():
            centre, half = ranges[name]
            wave[j, inputs.index(name)] = 0.5 * np.pi * a / half
            # a wave begins at one end, a straight line is the middle of a node
            phase[j] -= 0.5 * np.pi * (a * (centre - half) / half if a != LINEAR else 1.0 + a * centre / half)
    return phase, wave


def middle_range(values: Floats) -> tuple[float, float]:
    """The lowest and the highest of the middle 98 % of `values`."""
    low, high = np.quantile(values, (0.01, 0.99))
    return float(low), float(high)


def _range(name: str, values: Floats) -> tuple[float, float]:
    """Centre and half width of the range of a quantity: of its middle 98 % where these are not one value, else of all.

    Place and time count whole.
    """
    low, high = middle_range(values)
    if name in INPUTS[OF_THE_CAR:] or high - low < 2.0 * LEAST_HALF_WIDTH:
        low, high = float(np.min(values)), float(np.max(values))
    return 0.5 * (low + high), max(0.5 * (high - low), LEAST_HALF_WIDTH)

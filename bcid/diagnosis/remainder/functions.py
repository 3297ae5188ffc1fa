"""The functions of a remainder: half waves of what a drive went through, alone and in pairs, in every channel.

A quantity that ranged over [c - h, c + h] enters as cos(pi a (s - c + h) / (2 h)), a = 1, 2, ...: the cosines that are
orthogonal over the range.  Two of them are multiplied by their sums and differences, cos A cos B being half of
cos(A + B) + cos(A - B).  Coefficients of fine functions are expected to be smaller, by 1 / (1 + a^2 + b^2): what is
smooth is likelier.  No function is a law of the vocabulary.
"""

import itertools
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.effects.remainder import COLUMNS, DIRECTION, DIRECTIONS, INPUTS, PHASE, WAVE
from bcid.likelihood.hypothesis import Remainder
from bcid.physics.car import Car

TURN_RAD = 0.1
"""A change of the wheel's angle that counts as much as 1 m/s^2 in the prior's common size."""

Waves = Mapping[str, int]  # half waves over the range of a quantity, by its name; a negative number turns the wave round


class Term(NamedTuple):
    """A function: its channel, the direction in which it acts, and its half waves."""

    channel: str
    direction: str
    waves: Waves


class RemainderBasis(NamedTuple):
    """All functions that a remainder may have, with the size to which each is expected to act."""

    functions: Floats  # (K, COLUMNS) with coefficients of zero
    channel: tuple[str, ...]  # (K,)
    size: Floats  # (K,) of a coefficient, beside others of its channel (m/s^2, rad/s^2, rad)

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels, each once, in their order."""
        return tuple(dict.fromkeys(self.channel))

    def sd(self, spread: Mapping[str, float]) -> Floats:
        """Prior standard deviations (K,) of the coefficients, by the `spread` of each channel."""
        return self.size * np.array([spread[name] for name in self.channel])

    def choose(self, spread: Mapping[str, float]) -> Remainder:
        """The functions of the channels whose `spread` is not zero."""
        sd = self.sd(spread)
        on = np.flatnonzero(sd)
        return Remainder(self.functions[on], tuple(self.channel[i] for i in on), sd[on])


def _alone(channel: str, direction: str, **most: int) -> Iterator[Term]:
    """Half waves of single quantities, from one up to so many of each; a constant goes before them."""
    yield Term(channel, direction, {})
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


LOW, MORE = ((1, 1),), ((1, 1), (2, 1), (1, 2))
TERMS: tuple[Term, ...] = (
    *_alone("fx", "body_x", v_x=4, p_x=2, p_y=2, t=3),
    *_together("fx", "body_x", "v_x", "omega", *LOW),
    *_together("fx", "body_x", "p_x", "p_y", *MORE),
    *_together("fx", "body_x", "v_x", "t", *MORE),
    *_alone("fx", "front_along", v_fx=3, delta=2),
    *_together("fx", "front_along", "v_fx", "delta", *MORE),
    *(t for d in ("world_x", "world_y") for t in _alone("fx", d, p_x=2, p_y=2)),
    *(t for d in ("world_x", "world_y") for t in _together("fx", d, "p_x", "p_y", *LOW)),
    *_alone("fy", "front_across", alpha_f=4, v_fx=2, t=2),
    *_together("fy", "front_across", "alpha_f", "v_fx", *LOW),
    *_together("fy", "front_across", "alpha_f", "u_m", *LOW),
    *_together("fy", "front_across", "alpha_f", "t", *MORE),
    *_by_place("fy", "front_across", "alpha_f", (1, 1), (2, 2), (1, 2), (2, 1)),
    *_alone("fy", "rear_across", alpha_r=3, v_x=2),
    *_together("fy", "rear_across", "alpha_r", "t", *LOW),
    *_alone("mz", "yaw", omega=4, delta_rate=2, v_x=2, u_m=2, t=2),
    *_together("mz", "yaw", "omega", "v_x", *LOW),
    *_together("mz", "yaw", "omega", "t", *LOW),
    *_together("mz", "yaw", "u_m", "delta", *LOW),
    *_alone("motor", "driven_along", u_m=4),
    *_together("motor", "driven_along", "u_m", "v_fx", *MORE, (2, 2)),
    *_together("motor", "driven_along", "u_m", "t", *MORE),
    *_alone("steering", "wheel_angle", delta=4, delta_rate=3, t=1),
    *_together("steering", "wheel_angle", "delta", "delta_rate", *LOW),
    *_together("steering", "wheel_angle", "delta", "v_x", *LOW),
    *_together("steering", "wheel_angle", "delta", "t", *LOW),
)
"""All functions.  Time and place are among what each may depend on: what changes slowly or here and there is physics,
too."""


def remainder_basis(quantities: Mapping[str, Floats], car: Car) -> RemainderBasis:
    """The functions of a remainder for a drive that went through `quantities` (n,), by the names in INPUTS.

    The middle 98 % of a quantity count as its range, of place and time all.
    """
    ranges = {name: _range(name, quantities[name]) for name in INPUTS}
    per_turn = car.m * 0.5 * (car.l_f + car.l_r) / car.I_z  # rad/s^2 by a force of 1 m/s^2 at an axle
    size = {"yaw": per_turn, "wheel_angle": TURN_RAD}
    table, sizes = np.zeros((len(TERMS), COLUMNS)), np.empty(len(TERMS))
    for j, (_, direction, waves) in enumerate(TERMS):
        table[j, DIRECTION] = DIRECTIONS.index(direction)
        for name, a in waves.items():
            centre, half = ranges[name]
            wave = 0.5 * np.pi * a / half
            table[j, WAVE + INPUTS.index(name)] = wave
            table[j, PHASE] -= wave * (centre - half)
        sizes[j] = size.get(direction, 1.0) / (1.0 + sum(a * a for a in waves.values()))
    return RemainderBasis(table, tuple(t.channel for t in TERMS), sizes)


def _range(name: str, values: Floats) -> tuple[float, float]:
    """Centre and half width of the range of a quantity."""
    cut = 0.0 if name in ("p_x", "p_y", "t") else 0.01
    low, high = np.quantile(values, (cut, 1.0 - cut))
    return float(0.5 * (low + high)), max(float(0.5 * (high - low)), 1e-6)

"""The suites: what is concealed where, from one seed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from bcid.proof.blind.concealed_effects import MEASUREMENT, MOST, OUTSIDE, SIZES, Concealed, conceal, flaws, outside
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import Drive, drive, slow_circles

ROUGHNESS = {"rough_force": 3.0, "rough_moment": 1.5}
"""Of the floor, N and N m, wherever the base is imperfect or the recording harder; a matched car has no extras."""
FAMILIES = {
    "fx": (
        "rear_rolling_coulomb", "rear_rolling_viscous", "front_coulomb_friction", "quadratic_drag",
        "rear_drag_asymmetry", "steering_drag", "rough_patch", "floor_slope", "tether_pull",
    ),
    "mz": ("yaw_scrub", "yaw_coulomb", "drive_lateral_offset", "rear_drag_asymmetry"),
    "fy": (
        "tyre_relaxation", "friction_circle", "tyre_soft_saturation", "load_transfer", "front_ply_steer", "rear_toe",
        "slippery_patch",
    ),
    "motor": (
        "motor_delay", "motor_lag", "motor_dead_zone", "motor_sag", "motor_power_limit", "motor_regeneration",
    ),
    "steering": (
        "steering_offset", "steering_backlash", "steering_dead_band", "steering_delay", "steering_lag",
        "steering_nonlinearity", "steering_side_gain", "steering_speed_gain", "steering_rate_asymmetry",
        "steering_compliance",
    ),
    "time": ("pose_latency", "clock_drift"),
    "pose": ("marker_offset", "body_yaw_misalignment", "pose_scale"),
}  # fmt: skip
"""What is left out of the vocabulary where one of a family is concealed."""

EQUALS = {"pose_latency": ("steering_delay", "motor_delay")}
"""Left out with an effect that together they are exactly equal to."""

FEWER = 4  # of the effects, one in so many is tried on harder recordings
HARDER = (("two-minutes", 120.0, 60.0, 1.0), ("ten-hertz", 600.0, 10.0, 1.0), ("three-times-noise", 600.0, 60.0, 3.0))
"""Tier, duration (s), poses per second, times the usual noise."""
OTHERWISE = (("thirty-minutes", 1800.0, 60.0, 1.0, 8), ("hundred-twenty-hertz", 600.0, 120.0, 1.0, 4))
"""The same, and one of how many effects is tried."""

QUIET = (
    "motor_power_limit", "friction_circle", "tyre_soft_saturation", "load_transfer", "steering_rate_asymmetry",
    "motor_regeneration",
)  # fmt: skip
"""Effects that slow circles do not show."""


@dataclass(frozen=True)
class Case:
    """One concealed recording and its answer."""

    tier: str
    number: int
    concealed: tuple[Concealed, ...]
    imperfect: bool = False
    left_out: tuple[str, ...] = ()
    channel: str = ""  # of a left-out family
    duration_s: float = 600.0
    rate_hz: float = 60.0
    noise: float = 1.0  # times the usual
    driver: Literal["drawn", "pursuit", "circles"] = "drawn"
    seed: int = 0

    @property
    def name(self) -> str:
        """Unique within a suite."""
        return f"{self.tier}-{self.number:04d}"

    @property
    def answer(self) -> tuple[str, ...]:
        """What is there."""
        return tuple(c.effect for c in self.concealed)

    @property
    def nameable(self) -> dict[str, dict[str, float]]:
        """Of what is there all that the search may name, with its parameters."""
        return {} if self.channel else {c.effect: dict(c.parameters) for c in self.concealed}

    def plant(self) -> Plant:
        """The car with what is concealed."""
        rng = np.random.default_rng([self.seed, self.number, 7])
        base = {**ROUGHNESS, **flaws(rng)} if self.imperfect else {}
        if (self.duration_s, self.rate_hz, self.noise) != (USUAL.duration_s, USUAL.rate_hz, USUAL.noise):
            base |= ROUGHNESS
        more = {k: v for c in self.concealed for k, v in c.plant.items()}
        return Plant(**{**base, **more})

    def digest(self) -> str:
        """Of what is driven and of what the diagnosis may not name; the tier's name and number do not count."""
        made: list[object] = [self._drive_seed(), self.driver, self.duration_s, self.left_out]
        for values, usual in ((self.plant(), Plant()), (self.sensor(), Sensor())):
            made.append([(k, v) for k, v in values._asdict().items() if v != getattr(usual, k)])
        return hashlib.sha256(repr(made).encode()).hexdigest()[:16]

    def sensor(self) -> Sensor:
        """The motion capture with what is concealed."""
        more = {k: v for c in self.concealed for k, v in c.sensor.items()}
        usual = Sensor()
        return usual._replace(
            rate_hz=self.rate_hz, position_noise=self.noise * usual.position_noise,
            yaw_noise=self.noise * usual.yaw_noise, **more,
        )  # fmt: skip

    def driven(self) -> Drive:
        """The drive."""
        given = slow_circles(self.duration_s) if self.driver == "circles" else None
        return drive(
            self.plant(), self.sensor(), self.duration_s, self._drive_seed(), given=given,
            pursues=self.driver == "pursuit",
        )  # fmt: skip

    def _drive_seed(self) -> int:
        return int(np.random.default_rng([self.seed, self.number, 11]).integers(2**31))


USUAL = Case("usual", 0, ())


Conceals = Callable[[np.random.Generator], tuple[Concealed, ...]]


class _Draft(NamedTuple):
    """A case before its number, of which its seed draws what is concealed how large and where."""

    tier: str
    conceals: Conceals
    more: Mapping[str, Any] = MappingProxyType({})


def suite(seed: int, repeats: int, nulls: int, imperfect_nulls: int, pairs: int, more: bool = True) -> Iterator[Case]:
    """All tiers, from one seed; without `more` those that have goals, and harder recordings."""
    drafts = _with_goals(repeats, nulls, imperfect_nulls, pairs)
    for number, draft in enumerate(chain(drafts, _others(repeats, pairs) if more else ())):
        hidden = draft.conceals(np.random.default_rng([seed, number, 3]))
        yield Case(draft.tier, number, hidden, seed=seed, **draft.more)


def _with_goals(repeats: int, nulls: int, imperfect_nulls: int, pairs: int) -> Iterator[_Draft]:
    """One effect, nothing, what may not be named, two; harder recordings."""
    for imperfect, tier in ((False, "single"), (True, "single-imperfect")):
        for effect in repeats * [*SIZES]:
            yield _Draft(tier, _one(effect), {"imperfect": imperfect})
    yield from nulls * [_Draft("null", _nothing)]
    yield from imperfect_nulls * [_Draft("null-imperfect", _nothing, {"imperfect": True})]
    for channel, family in FAMILIES.items():
        for effect in family:
            left_out = (*family, *EQUALS.get(effect, ()))
            yield _Draft("left-out", _one(effect), {"left_out": left_out, "channel": channel})
    yield from pairs * [_Draft("pair", _several(2))]
    for tier, duration, rate, noise in HARDER:
        for effect in [*SIZES][::FEWER]:
            yield _recorded(tier, effect, duration, rate, noise)


def _others(repeats: int, pairs: int) -> Iterator[_Draft]:
    """Other sizes, several at once, what has no name, what is not excited, other drivers and recordings."""
    for effect in SIZES:
        yield _Draft("half-size", _one(effect, times=0.5))
    for effect in SIZES:
        if effect not in MOST:
            yield _Draft("double-size", _one(effect, times=2.0))
    yield from (2 * pairs // 5) * [_Draft("triple", _several(3))]
    yield from (2 * pairs // 5) * [_Draft("measurement-and-vehicle", _measurement_and_vehicle)]
    for effect, (channel, _) in repeats * [*OUTSIDE.items()]:
        yield _Draft("outside", _nameless(effect), {"channel": channel})
    for effect in QUIET:
        yield _Draft("unexcited", _one(effect), {"driver": "circles"})
    for effect in [*SIZES][1::2]:
        yield _Draft("closed-loop", _one(effect), {"driver": "pursuit"})
    for tier, duration, rate, noise, fewer in OTHERWISE:
        for effect in [*SIZES][2::fewer]:
            yield _recorded(tier, effect, duration, rate, noise)


def _recorded(tier: str, effect: str, duration: float, rate: float, noise: float) -> _Draft:
    """One effect in a recording that is not the usual one."""
    return _Draft(tier, _one(effect, duration), {"duration_s": duration, "rate_hz": rate, "noise": noise})


def _nothing(_: np.random.Generator) -> tuple[Concealed, ...]:
    return ()


def _one(effect: str, duration: float = USUAL.duration_s, times: float = 1.0) -> Conceals:
    """An effect, so many times its size."""
    return lambda draw: (conceal(effect, draw, duration, times),)


def _nameless(effect: str) -> Conceals:
    """An effect that has no id."""
    return lambda draw: (outside(effect, draw),)


def _several(count: int) -> Conceals:
    """Different effects at their sizes."""
    names = list(SIZES)
    return lambda draw: tuple(
        conceal(names[i], draw, USUAL.duration_s) for i in draw.choice(len(names), count, replace=False)
    )


def _measurement_and_vehicle(draw: np.random.Generator) -> tuple[Concealed, ...]:
    names = [str(draw.choice(MEASUREMENT)), str(draw.choice([n for n in SIZES if n not in MEASUREMENT]))]
    return tuple(conceal(name, draw, USUAL.duration_s) for name in names)


def subset(cases: list[Case], every: int) -> list[Case]:
    """A fixed part of every tier: work on this, run all at the end."""
    chosen = []
    for tier in dict.fromkeys(c.tier for c in cases):
        chosen += [c for c in cases if c.tier == tier][::every]
    return chosen


QUICK_EVERY = {
    "single": 30, "single-imperfect": 60, "null": 100, "null-imperfect": 100, "left-out": 20, "pair": 50, "outside": 14,
    "unexcited": 6, "closed-loop": 20, "two-minutes": 11,
}  # fmt: skip
"""Of each tier, one in so many makes eighteen cases."""


def quick_suite(cases: Sequence[Case], seed: int) -> list[Case]:
    """Eighteen of the cases, drawn from the tiers in which most is at stake."""
    drawn = list[Case]()
    for k, (tier, every) in enumerate(QUICK_EVERY.items()):
        of = [c for c in cases if c.tier == tier]
        shuffled = [of[i] for i in np.random.default_rng([seed, k, 5]).permutation(len(of))]
        different = list({c.answer: c for c in shuffled}.values())
        few = max(len(of[every // 2 :: every]), min(len(of), 1))
        drawn += (different if len(different) >= few else shuffled)[:few]
    return drawn

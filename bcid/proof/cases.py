"""The suites: what is concealed where, from one seed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bcid.proof.concealed import SIZES, Concealed, conceal, flaws
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import Drive, drive

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

SEVERAL = {"rear_drag_asymmetry": ("fx", "mz"), "floor_slope": ("fx", "fy"), "tether_pull": ("fx", "fy")}
"""Effects that act in two channels (specification): either is right."""


FEWER = 4  # of the effects, one in so many is tried on harder recordings
HARDER = (("two-minutes", 120.0, 60.0, 1.0), ("ten-hertz", 600.0, 10.0, 1.0), ("three-times-noise", 600.0, 60.0, 3.0))
"""Tier, duration (s), poses per second, times the usual noise."""


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
    seed: int = 0

    @property
    def name(self) -> str:
        """Unique within a suite."""
        return f"{self.tier}-{self.number:04d}"

    @property
    def answer(self) -> tuple[str, ...]:
        """What is there."""
        return tuple(c.effect for c in self.concealed)

    def plant(self) -> Plant:
        """The car with what is concealed."""
        rng = np.random.default_rng([self.seed, self.number, 7])
        base = {**ROUGHNESS, **flaws(rng)} if self.imperfect else {}
        if (self.duration_s, self.rate_hz, self.noise) != (USUAL.duration_s, USUAL.rate_hz, USUAL.noise):
            base |= ROUGHNESS
        more = {k: v for c in self.concealed for k, v in c.plant.items()}
        return Plant(**{**base, **more})

    def digest(self) -> str:
        """Of all that makes the case."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:12]

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
        seed = int(np.random.default_rng([self.seed, self.number, 11]).integers(2**31))
        return drive(self.plant(), self.sensor(), self.duration_s, seed)


USUAL = Case("usual", 0, ())


def suite(seed: int, repeats: int, nulls: int, imperfect_nulls: int, pairs: int) -> Iterator[Case]:
    """All tiers of the issue: singles, nulls, left-out families, pairs, and harder recordings."""
    number = 0

    def rng() -> np.random.Generator:
        return np.random.default_rng([seed, number, 3])

    for imperfect, tier in ((False, "single"), (True, "single-imperfect")):
        for _ in range(repeats):
            for effect in SIZES:
                yield Case(tier, number, (conceal(effect, rng(), 600.0),), imperfect, seed=seed)
                number += 1
    for _ in range(nulls):
        yield Case("null", number, (), seed=seed)
        number += 1
    for _ in range(imperfect_nulls):
        yield Case("null-imperfect", number, (), True, seed=seed)
        number += 1
    for channel, family in FAMILIES.items():
        for effect in family:
            hidden = (conceal(effect, rng(), 600.0),)
            yield Case("left-out", number, hidden, left_out=family, channel=channel, seed=seed)
            number += 1
    names = list(SIZES)
    for _ in range(pairs):
        draw = rng()
        one, other = draw.choice(len(names), 2, replace=False)
        both = (conceal(names[one], draw, 600.0), conceal(names[other], draw, 600.0))
        yield Case("pair", number, both, seed=seed)
        number += 1
    for tier, duration, rate, noise in HARDER:
        for effect in names[::FEWER]:
            hidden = (conceal(effect, rng(), duration),)
            yield Case(tier, number, hidden, duration_s=duration, rate_hz=rate, noise=noise, seed=seed)
            number += 1


def subset(cases: list[Case], every: int) -> list[Case]:
    """A fixed part of every tier: work on this, run all at the end."""
    chosen = []
    for tier in dict.fromkeys(c.tier for c in cases):
        chosen += [c for c in cases if c.tier == tier][::every]
    return chosen

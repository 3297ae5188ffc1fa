"""The tiers of small cars in a blind test, drawn from one seed.

`small-exact`: the published simulation is the car's to the last digit, less one effect that it has.  `small-plus`: all
of it, and one further effect in the car.  `small-null`: nothing is missing.  `small-wrong`: one effect less, and four
other things are otherwise than published: motor 10 %, grip 15 %, play in the steering, marker 1 cm.  `small-outside`:
something is there that no vocabulary names.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from bcid.proof.blind.concealed_effects import ConcealedEffect
from bcid.proof.blind.small_case import SmallCase
from bcid.proof.blind.small_effects import (
    NEEDED_DRIVERS,
    OUTSIDE_CHANNELS,
    SMALL_OUTSIDE_SIZES,
    SMALL_SIZES,
    draw_small_effect,
    draw_small_outside_effect,
    kinds_of_car,
)
from bcid.proof.blind.small_files import PUBLISHED
from bcid.simulation.car import Plant
from bcid.simulation.room_drivers import DRIVERS
from bcid.simulation.small_car import draw_small_car

NAMED_CONSTANTS = {effect: constant for constant, (effect, _) in PUBLISHED.items() if effect in SMALL_SIZES}
"""Effects that a published simulation has and that the vocabulary names, with the plant's constant."""

SHORTEST_S, LONGEST_S = 45, 180
COMMAND_RATES_HZ = (10.0, 10.0, 20.0, 25.0, 50.0)
POSE_RATES_HZ = (100.0, 100.0, 120.0)
TRUSTS = (0.02, 0.05, 0.1)  # of a simulation that is exact
ROUGH_TRUST = 0.1  # of one that is not
MOTOR_ERROR, GRIP_ERROR, MARKER_ERROR_M = 0.10, 0.15, 0.01
PLAY_RAD = (0.008, 0.02)

SmallCaseDraw = Callable[[int, int], SmallCase]
"""Draws a case from the suite's seed and the case's number."""


def draft_small_cases(repeats: int, nulls: int) -> Iterator[SmallCaseDraw]:
    """Yield for each case of a small car, in order, the function that draws it.

    There are `repeats` cases of each effect in a tier, `nulls` without any, and one of each outside the vocabulary.
    """
    for effect in repeats * [*NAMED_CONSTANTS]:
        yield partial(_draw_less_one, "small-exact", effect)
    for effect in repeats * [*SMALL_SIZES]:
        yield partial(_draw_plus_one, effect)
    yield from nulls * [_draw_nothing]
    for effect in repeats * [*NAMED_CONSTANTS]:
        yield partial(_draw_less_one, "small-wrong", effect)
    for effect in SMALL_OUTSIDE_SIZES:
        yield partial(_draw_outside, effect)


def draw_take(rng: np.random.Generator, needed_driver: str = "") -> dict[str, Any]:
    """Draw how a small car is driven and measured: length of the take, rates, and driver unless one is needed."""
    return {
        "duration_s": float(rng.integers(SHORTEST_S, LONGEST_S + 1)), "rate_hz": float(rng.choice(POSE_RATES_HZ)),
        "command_hz": float(rng.choice(COMMAND_RATES_HZ)),
        "driver": needed_driver or str(rng.choice(DRIVERS)),
    }  # fmt: skip


def _draw_less_one(tier: str, effect: str, seed: int, number: int) -> SmallCase:
    """Draw a car that has `effect`, which its simulation lacks; in "small-wrong" four other things are wrong, too."""
    rng = np.random.default_rng([seed, number, 3])
    constant = NAMED_CONSTANTS[effect]
    car = draw_small_car(rng, having=(constant,))
    hidden = ConcealedEffect(effect, parameters={PUBLISHED[constant][1]: float(getattr(car.plant, constant))})
    wrong = tier == "small-wrong"
    trust = ROUGH_TRUST if wrong else float(rng.choice(TRUSTS))
    return SmallCase(
        tier, number, (hidden,), seed=seed, car=car, trust=trust, withheld=(effect,),
        flaws=_draw_flaws(car.plant, rng) if wrong else (), **draw_take(rng),
    )  # fmt: skip


def _draw_flaws(plant: Plant, rng: np.random.Generator) -> tuple[ConcealedEffect, ...]:
    """Draw four things that are otherwise in the car than published; two of them are effects of the vocabulary."""
    motor, grip = (1.0 + share * float(rng.choice([-1.0, 1.0])) for share in (MOTOR_ERROR, GRIP_ERROR))
    play, angle = float(rng.uniform(*PLAY_RAD)), rng.uniform(-np.pi, np.pi)
    x, y = float(MARKER_ERROR_M * np.cos(angle)), float(MARKER_ERROR_M * np.sin(angle))
    return (
        ConcealedEffect("motor", {"throttle_force": motor * plant.throttle_force}),
        ConcealedEffect("grip", {"front_grip": grip * plant.front_grip, "rear_grip": grip * plant.rear_grip}),
        ConcealedEffect("steering_backlash", {"steering_backlash": play}, parameters={"b": play}),
        ConcealedEffect(
            "marker_offset", sensor={"marker_offset_x": x, "marker_offset_y": y}, parameters={"d_x": x, "d_y": y}
        ),
    )


def _draw_plus_one(effect: str, seed: int, number: int) -> SmallCase:
    """Draw a car whose simulation is exact but for one further `effect` of the vocabulary in the car."""
    rng = np.random.default_rng([seed, number, 3])
    own = tuple(constant for constant, (published, _) in PUBLISHED.items() if published == effect)
    car = draw_small_car(rng, lacking=own)
    while effect not in kinds_of_car(car.plant):
        car = draw_small_car(rng, lacking=own)
    take = draw_take(rng)
    hidden = draw_small_effect(effect, car.plant, rng, take["duration_s"])
    trust = float(rng.choice(TRUSTS))
    return SmallCase("small-plus", number, (hidden,), seed=seed, car=car, trust=trust, **take)


def _draw_nothing(seed: int, number: int) -> SmallCase:
    """Draw a car whose simulation is exact."""
    rng = np.random.default_rng([seed, number, 3])
    car, trust = draw_small_car(rng), float(rng.choice(TRUSTS))
    return SmallCase("small-null", number, (), seed=seed, car=car, trust=trust, **draw_take(rng))


def _draw_outside(effect: str, seed: int, number: int) -> SmallCase:
    """Draw a car whose simulation is exact but for an `effect` that no vocabulary names."""
    rng = np.random.default_rng([seed, number, 3])
    car, trust = draw_small_car(rng), float(rng.choice(TRUSTS))
    hidden = draw_small_outside_effect(effect, car.plant, rng)
    return SmallCase(
        "small-outside", number, (hidden,), channel=OUTSIDE_CHANNELS[effect], seed=seed, car=car, trust=trust,
        **draw_take(rng, NEEDED_DRIVERS.get(effect, "")),
    )  # fmt: skip

"""The tiers of small cars that are other than their published simulation, as real ones are, drawn from one seed.

`other-laws`: the car's laws are of other formulas than the vocabulary's, the simulation has what an author would fit
to them, and each of its figures is off by 10 to 30 %, as it says.  `other-day`: the laws are the vocabulary's, but
battery, floor and the steering's trim are another day's.  Nothing is withheld there; in `other-laws-less` and
`other-day-less` one effect is.
"""

import math
from collections.abc import Iterator
from functools import partial
from itertools import cycle, islice

import numpy as np

from bcid.proof.blind.concealed_effects import ConcealedEffect
from bcid.proof.blind.nearest_figures import STEERED_DRAGS, nearest_figures
from bcid.proof.blind.published_case import PublishedCase
from bcid.proof.blind.small_files import PUBLISHED
from bcid.proof.blind.small_suite import NAMED_CONSTANTS, SmallCaseDraw, draw_take
from bcid.simulation.car import Plant
from bcid.simulation.small_car import draw_car_of_other_laws, draw_small_car

FIGURES_OF_OTHER_LAWS = (
    "I_z", "T_s", "K_t", "K_v", "K_b", "C_f", "C_r", "F_f_max", "F_r_max", "R_1", "R_2", "motor_dead_zone",
    "motor_lag", "motor_fade", "rear_rolling_coulomb", "tyre_soft_saturation", "steering_side_gain",
    "steering_nonlinearity", "steering_offset", "steering_delay", "steering_drag", "steering_friction",
)  # fmt: skip
"""What a simulation of a car of other laws may have, in the order in which its errors are drawn."""

WITHHELD_OF_OTHER_LAWS = (
    ("motor_dead_zone",), ("motor_lag",), ("rear_rolling_coulomb",), STEERED_DRAGS, ("steering_side_gain",),
    ("steering_nonlinearity",), ("tyre_soft_saturation",), ("steering_offset",),
)  # fmt: skip
"""What such a simulation may lack: one thing, which may be several effects; the last is the one asked for."""

RELATIVE_SD = (0.1, 0.3)  # how well a published figure is known
LARGEST_ERROR_SD = 2.0
DAY_TRUSTS = (0.02, 0.05)  # of what does not change from day to day

# what a day does, at most: two cells at 7.0 to 8.4 V, floors, a horn that was put on anew
MOTOR_DAY, ROLLING_DAY, GRIP_DAY = 0.08, 0.3, 0.2
ZONE_DAY, TRIM_DAY_RAD = 0.02, 0.01
TRIM_RAD = (0.008, 0.02)


def draft_other_cases(other_laws: int, other_day: int) -> Iterator[SmallCaseDraw]:
    """Yield for each case of these tiers, in order, the function that draws it.

    There are `other_laws` cases of other laws with nothing withheld, as many with one effect less, and `other_day` of
    another day of either kind.
    """
    yield from other_laws * [partial(_draw_other_laws, ())]
    for withheld in islice(cycle(WITHHELD_OF_OTHER_LAWS), other_laws):
        yield partial(_draw_other_laws, withheld)
    yield from other_day * [partial(_draw_other_day, "")]
    for effect in islice(cycle(NAMED_CONSTANTS), other_day):
        yield partial(_draw_other_day, effect)


def _draw_other_laws(withheld: tuple[str, ...], seed: int, number: int) -> PublishedCase:
    """Draw a car of other laws, and a simulation of the vocabulary's nearest to them, less what is `withheld`."""
    rng = np.random.default_rng([seed, number, 3])
    car = draw_car_of_other_laws(rng, with_dry_steered_drag=withheld == STEERED_DRAGS)
    sds = rng.uniform(*RELATIVE_SD, len(FIGURES_OF_OTHER_LAWS))
    errors = sds * np.clip(rng.standard_normal(len(sds)), -LARGEST_ERROR_SD, LARGEST_ERROR_SD)
    tier, hidden = "other-laws", tuple[ConcealedEffect, ...]()
    if withheld:
        asked = withheld[-1]
        tier = "other-laws-less"
        hidden = (ConcealedEffect(asked, parameters=nearest_figures(car.plant).effects[asked]),)
    return PublishedCase(
        tier, number, hidden, seed=seed, car=car, trust=RELATIVE_SD[0], withheld=withheld, other_laws=True,
        relative_sd_of=tuple(zip(FIGURES_OF_OTHER_LAWS, sds.round(3).tolist(), strict=True)),
        errors=tuple(zip(FIGURES_OF_OTHER_LAWS, errors.round(4).tolist(), strict=True)), **draw_take(rng),
    )  # fmt: skip


def _draw_other_day(effect: str, seed: int, number: int) -> PublishedCase:
    """Draw a car whose battery, floor and trim are another day's than its simulation's, which may lack an `effect`."""
    rng = np.random.default_rng([seed, number, 3])
    car = draw_small_car(rng, having=(NAMED_CONSTANTS[effect],) if effect else ())
    trim = float(rng.choice([-1.0, 1.0]) * rng.uniform(*TRIM_RAD))
    car = car._replace(plant=car.plant._replace(steering_offset=trim))
    day = _draw_day(car.plant, rng)
    hidden = tuple[ConcealedEffect, ...]()
    if effect:
        constant = NAMED_CONSTANTS[effect]
        today = {k: v for change in day for k, v in change.plant.items()}
        size = today.get(constant, getattr(car.plant, constant))
        hidden = (ConcealedEffect(effect, parameters={PUBLISHED[constant][1]: float(size)}),)
    return PublishedCase(
        "other-day-less" if effect else "other-day", number, hidden, seed=seed, car=car,
        trust=float(rng.choice(DAY_TRUSTS)), withheld=(effect,) if effect else (), flaws=day,
        relative_sd_of=tuple(_day_sds(car.plant).items()), **draw_take(rng),
    )  # fmt: skip


def _draw_day(p: Plant, rng: np.random.Generator) -> tuple[ConcealedEffect, ...]:
    """Draw what a day changes in a published car: motor force and dead zone, rolling friction and grip, trim."""
    motor, rolling, grip = (1.0 + float(rng.uniform(-most, most)) for most in (MOTOR_DAY, ROLLING_DAY, GRIP_DAY))
    zone, trim = (float(rng.uniform(-most, most)) for most in (ZONE_DAY, TRIM_DAY_RAD))
    rolls = ("rear_rolling_coulomb", "rolling_drag", "rolling_drag_2")
    return (
        ConcealedEffect("battery", {"throttle_force": motor * p.throttle_force,
                                    "motor_dead_zone": p.motor_dead_zone + zone}),
        ConcealedEffect("floor", {**{name: rolling * getattr(p, name) for name in rolls},
                                  "front_grip": grip * p.front_grip, "rear_grip": grip * p.rear_grip}),
        ConcealedEffect("trim", {"steering_offset": p.steering_offset + trim}),
    )  # fmt: skip


def _day_sds(p: Plant) -> dict[str, float]:
    """Standard deviations, as shares of published figures, of what a day does: those of uniform changes."""
    share = {
        "K_t": MOTOR_DAY, "R_1": ROLLING_DAY, "R_2": ROLLING_DAY, "F_f_max": GRIP_DAY, "F_r_max": GRIP_DAY,
        "motor_dead_zone": ZONE_DAY / p.motor_dead_zone, "rear_rolling_coulomb": ROLLING_DAY,
        "steering_offset": TRIM_DAY_RAD / abs(p.steering_offset),
    }  # fmt: skip
    return {name: round(most / math.sqrt(3.0), 3) for name, most in share.items()}

"""What of a car can be adapted while it drives, how much it may change, and between which bounds.

A limit of a force that no drive of the model's had reached is no constant of the car, but as far as these drives went:
the fit's own test says that a far larger one would do as well.  A heavier car goes farther.  So such limits are
released (`release_limits`) before anything is adapted.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from bcid.effects.table import EFFECTS
from bcid.errors import UsageError
from bcid.models.interface import Model
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import GRAVITY, SATURATIONS

GROUPS = {
    "mass": ("m", "I_z"),
    "grip": ("C_f", "C_r", "F_f_max", "F_r_max"),
    "motor": ("K_t", "F_m_max"),
    "drag": ("R_1", "R_2"),
}
"""Constants of the car that change by one factor, by what an engineer calls it: a load changes m and I_z alike."""

FACTOR_SD = 0.2
"""Standard deviation, relative, by which a constant of the car may change: by a passenger, or on another floor."""
FACTOR_BOUNDS = (0.25, 4.0)
"""Least and largest factor on a constant of the car: as far as a car with a load stays the same car."""
EFFECT_SD_SIZES = 3.0
"""Standard deviation of an effect's parameter, in sizes at which ten minutes just show it."""
LEAST_ABOVE_LOW = 1.2
"""Times the lower end of its range from which on a fitted limit is not at that end."""
SMALLEST_SIZE = 1e-9
"""In sizes of an effect, what stands for none where it is adapted: at zero its law is not a part of the formulas."""
ONE_SIDED_START, ONE_SIDED_LOW = 1.0, 1e-3
"""In sizes of an effect that cannot be less than none, such as a lag: where it starts, and the least that it is taken
for.  At none at all its slope is, or a step of its law is no number, so that nothing would ever be learnt of it."""


class AdaptedQuantity(NamedTuple):
    """A number that is estimated while the car drives: a factor on constants of the car, or an effect's parameter."""

    name: str
    constants: tuple[str, ...]  # what it acts on, by the names in the formulas
    is_factor: bool
    start: float
    sd: float
    low: float
    high: float
    unit: str

    @property
    def symbol(self) -> str:
        """What it is called in formulas: a name that programming languages take, as its own may have a point."""
        return self.name.replace(".", "__")

    @property
    def said_start(self) -> float:
        """The first value as it is told: 0 where there was no such effect."""
        return 0.0 if abs(self.start) <= SMALLEST_SIZE * self.sd else self.start


def unreached_limits(model: Model) -> tuple[str, ...]:
    """Limits of forces that a fit of a newton-euler model tested, and found that none at all would do as well.

    Such a fit states no error of theirs.  One at the lower end of its range is no such limit: it was reached at once.
    A diagnosis makes no such test.
    """
    if not isinstance(model, NewtonEuler):
        return ()
    fitted, car = model.facts.get("fitted", {}), model.car._asdict()
    tested = [limit for limit in SATURATIONS if limit in fitted and fitted[limit]["relative_se"] is None]
    return tuple(limit for limit in tested if car[limit] > LEAST_ABOVE_LOW * fitted[limit]["low"])


def release_limits(model: AugmentedNewtonEuler, limits: Sequence[str]) -> AugmentedNewtonEuler:
    """The car with each of the `limits` at the weight m g, the most that a fit allows for, where it was below that."""
    weight = model.car.m * GRAVITY
    return replace(model, car=model.car._replace(**{s: max(weight, getattr(model.car, s)) for s in limits}))


def choose_quantities(
    model: AugmentedNewtonEuler, names: Sequence[str]
) -> tuple[AugmentedNewtonEuler, tuple[AdaptedQuantity, ...]]:
    """The quantities called `names`, and the model with the effects among them switched on.

    A name is one of GROUPS, a constant of the car such as `C_f`, an effect with one parameter, or EFFECT.SYMBOL.

    Raises:
        UsageError: nothing is called so, or two names change the same constant.
    """
    if not names:
        raise UsageError(f"nothing is named that could be adapted\n  next: name some of {', '.join(GROUPS)}")
    effects, quantities = dict(model.effects), []
    for name in names:
        if name in GROUPS or name in model.car._fields:
            quantities.append(_factor_on(model, name))
            continue
        field, quantity = _parameter_called(name, effects)
        effects[field] = quantity.start
        quantities.append(quantity)
    changed = [constant for quantity in quantities for constant in quantity.constants]
    if twice := {constant for constant in changed if changed.count(constant) > 1}:
        raise UsageError(
            f"{', '.join(names)}: {', '.join(sorted(twice))} would change twice\n  next: name one of them alone"
        )
    return replace(model, effects=effects), tuple(quantities)


def with_quantities(
    model: AugmentedNewtonEuler, values: Sequence[tuple[AdaptedQuantity, float]]
) -> AugmentedNewtonEuler:
    """The model with adapted quantities at their `values`."""
    car, effects = model.car._asdict(), dict(model.effects)
    for quantity, value in values:
        for constant in quantity.constants:
            if quantity.is_factor:
                car[constant] *= value
            else:
                effects[constant] = value
    return replace(model, car=model.car._replace(**car), effects=effects)


def _factor_on(model: AugmentedNewtonEuler, name: str) -> AdaptedQuantity:
    """The factor on a constant of the car, or on a group of them, as far as the car has them.

    Raises:
        UsageError: all of them are zero or infinite, so that a factor changes nothing.
    """
    values = {c: getattr(model.car, c) for c in GROUPS.get(name, (name,))}
    constants = tuple(c for c, value in values.items() if value != 0.0 and abs(value) != float("inf"))
    if not constants:
        raise UsageError(f"{name}: this car has none, so that nothing is to be adapted\n  next: name something else")
    return AdaptedQuantity(name, constants, True, 1.0, FACTOR_SD, *FACTOR_BOUNDS, "1")


def _parameter_called(name: str, effects: Mapping[str, float]) -> tuple[str, AdaptedQuantity]:
    """The field of an effect's parameter, and the quantity that it is.

    Raises:
        UsageError: no effect, or no parameter, is called so, or it has a place that the model does not know.
    """
    effect_id, _, symbol = name.partition(".")
    effect = EFFECTS.get(effect_id)
    if effect is None:
        known = [*GROUPS, *EFFECTS]
        near = ", ".join(difflib.get_close_matches(effect_id, known, n=3)) or ", ".join(GROUPS)
        raise UsageError(f"nothing that can be adapted is called {name}\n  next: name one such as {near}")
    sizes = {p.symbol: p for p in effect.parameters if not p.is_place and p.size != 0.0}
    if not symbol and len(sizes) == 1:
        symbol = next(iter(sizes))
    if symbol not in sizes:
        choices = ", ".join(f"{effect_id}.{s}" for s in sizes)
        raise UsageError(f"{name}: it is not said which parameter of the effect\n  next: name one of {choices}")
    if any(f"{effect_id}__{place.symbol}" not in effects for place in effect.place_parameters):
        raise UsageError(
            f"{name}: where or when the effect acts is not known of this model\n"
            "  next: adapt a model that a diagnosis made, or name something else"
        )
    p, field = sizes[symbol], f"{effect_id}__{symbol}"
    low, start = p.low, effects.get(field) or p.off + SMALLEST_SIZE * p.size
    if p.low == p.off:
        low = p.off + ONE_SIDED_LOW * p.size
        start = max(low, effects.get(field) or p.off + ONE_SIDED_START * p.size)
    return field, AdaptedQuantity(name, (field,), False, start, EFFECT_SD_SIZES * p.size, low, p.high, p.unit)

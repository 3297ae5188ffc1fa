"""All effects by id, in the specification's order of families."""

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.effects import forces, harmonics, measurement, motor, steering, tyres
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.entry import Effect
from bcid.effects.harmonics import AnglePlan
from bcid.effects.remainder_table import COLUMNS, ROOM
from bcid.errors import UsageError

EFFECTS: dict[str, Effect] = {
    e.id: e for module in (forces, tyres, motor, steering, measurement) for e in module.EFFECTS
}
"""The vocabulary."""

ENTRIES: dict[str, Effect] = EFFECTS | CORRECTIONS
"""All that can be fitted: the vocabulary and the base model's own simplifications."""

OFF: dict[str, float] = {name: p.off for e in ENTRIES.values() for name, p in zip(e.fields, e.parameters, strict=True)}
"""Every parameter's value at which nothing changes."""

ANY_ON_BODY = "any_on_body"
"""Field of the switches beside the parameters: 1 where an effect with a name acts on forces on the body, else 0."""

REMAINDERS, REMAINDER, FACTOR = "remainders", "remainder", "factor"
"""Fields of the switches for what has no name: how many functions, and the table of them (`bcid.effects.remainder`);
of which powers each is a product (`bcid.effects.harmonics`)."""

ANGLES, ANGLE, POWERS = "angles", "angle", "powers"
"""Fields for the angles from which functions are computed: how many, the table of them, and how many powers."""

BESIDE_BODY = (
    "steering_backlash", "steering_dead_band", "steering_delay", "steering_lag", "steering_rate_asymmetry",
    "motor_delay", "throttle_timing", "pose_latency", "clock_drift", "marker_offset", "body_yaw_misalignment",
    "pose_scale",
)  # fmt: skip
"""Effects that change commands before they reach the body, or poses after: forces on the body are the base model's."""

NO_FUNCTIONS = np.zeros((0, COLUMNS))

OWN_MARKS: list[str] = []
"""Fields beside the parameters that carry no number: they stand for the user's laws in use (`bcid.effects.own_laws`).
"""


@cache
def _layout(parameters: tuple[str, ...], marks: tuple[str, ...]) -> Any:
    """The numpy type of the switches' record, with the fields of these `parameters` and `marks`."""
    return np.dtype(
        (
            np.record,
            [
                *((name, np.float64) for name in (*parameters, ANY_ON_BODY, REMAINDERS, ANGLES, POWERS, *marks)),
                (REMAINDER, np.float64, (ROOM, harmonics.PLANNED_COLUMNS)),
                (FACTOR, np.int64, (ROOM, 1 + harmonics.FACTORS)),
                (ANGLE, np.float64, (harmonics.MOST_ANGLES, harmonics.ANGLE_COLUMNS)),
            ],
        )
    )


@cache
def _fields_on_body(parameters: tuple[str, ...]) -> frozenset[str]:
    """Those of the fields `parameters` whose effects act on forces on the body."""
    return frozenset(name for name in parameters if name.partition("__")[0] not in BESIDE_BODY)


@contextmanager
def further_effects(effects: Sequence[Effect], mark: str) -> Iterator[None]:
    """Context in which the vocabulary of this process holds `effects` of the user's beside its own.

    `mark` is the field of the switches under which their laws are registered (`bcid.effects.own_laws.LAWS`).

    Raises:
        UsageError: others of the user's are in use already, or an id is taken.
    """
    taken = sorted({e.id for e in effects} & ENTRIES.keys())
    if OWN_MARKS or taken:
        raise UsageError(f"{', '.join(taken) or 'another file'} in use already\n  next: leave the other effects first")
    entries = {e.id: e for e in effects}
    off = {name: p.off for e in effects for name, p in zip(e.fields, e.parameters, strict=True)}
    tables: tuple[tuple[dict[str, Any], dict[str, Any]], ...] = ((EFFECTS, entries), (ENTRIES, entries), (OFF, off))
    for table, more in tables:
        table.update(more)
    OWN_MARKS.append(mark)
    try:
        yield
    finally:
        OWN_MARKS.remove(mark)
        for table, more in tables:
            for name in more:
                del table[name]


def effect_switches(
    on: Mapping[str, float] | None = None, functions: Floats = NO_FUNCTIONS, plan: AnglePlan | None = None
) -> Any:
    """Parameters of all effects as one numpy record with fields such as "rough_patch__b", for the compiled functions.

    With it go the `functions` (K, COLUMNS) of a remainder, which has no name (`bcid.effects.remainder`), and the `plan`
    by which they are computed; where none is given each has an angle of its own.

    Values come from `on`, by field; parameters not in `on` have the value at which their effect is off, and with all
    off the car is the base model to the last bit.  A record is passed by its address: copying some sixty numbers at
    every call would cost a third of the computing time.
    """
    values, parameters = OFF | dict(on or {}), tuple(OFF)
    on_body = float(any(values[name] != OFF[name] for name in _fields_on_body(parameters)))
    switches = np.zeros((), dtype=_layout(parameters, tuple(OWN_MARKS)))
    for name, value in values.items():
        switches[name] = value
    switches[ANY_ON_BODY] = on_body
    if len(functions):
        plan = plan or harmonics.plan_angles(functions)
        angles, K = plan.angles, len(functions)
        switches[REMAINDERS], switches[ANGLES] = K, len(angles)
        switches[POWERS] = angles[:, [harmonics.POWERS, harmonics.INVERSE_POWERS]].sum()
        switches[REMAINDER][:K], switches[FACTOR][:K] = (
            harmonics.planned_table(functions, plan),
            plan.factors[plan.order],
        )
        switches[ANGLE][: len(angles)] = angles
    return switches[()]


def effect_ids(fields: Iterable[str]) -> tuple[str, ...]:
    """Ids of the effects to which parameter fields such as "rough_patch__b" belong, each once, in their order."""
    return tuple(dict.fromkeys(field.partition("__")[0] for field in fields))


def find_effect(name: str) -> Effect:
    """The effect with the id `name` in the vocabulary; raises `UsageError`, with similar ids, for others."""
    if name not in EFFECTS:
        near = ", ".join(difflib.get_close_matches(name, EFFECTS, n=3)) or "see `bcid effects`"
        raise UsageError(f"there is no effect {name!r}\n  next: {near}")
    return EFFECTS[name]

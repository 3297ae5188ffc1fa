"""All effects by id, in the specification's order of families."""

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.effects import forces, harmonics, measurement, motor, steering, tyres
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.entry import Effect
from bcid.effects.harmonics import AnglePlan
from bcid.effects.remainder_table import COLUMNS, MOST
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

_ON_BODY = frozenset(name for e in ENTRIES.values() if e.id not in BESIDE_BODY for name in e.fields)
_LAYOUT = np.dtype(
    (
        np.record,
        [
            *((name, np.float64) for name in (*OFF, ANY_ON_BODY, REMAINDERS, ANGLES, POWERS)),
            (REMAINDER, np.float64, (MOST, harmonics.PLANNED_COLUMNS)),
            (FACTOR, np.int64, (MOST, 1 + harmonics.FACTORS)),
            (ANGLE, np.float64, (harmonics.MOST_ANGLES, harmonics.ANGLE_COLUMNS)),
        ],
    )
)
NO_FUNCTIONS = np.zeros((0, COLUMNS))


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
    values = OFF | dict(on or {})
    on_body = float(any(values[name] != OFF[name] for name in _ON_BODY))
    switches = np.zeros((), dtype=_LAYOUT)
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

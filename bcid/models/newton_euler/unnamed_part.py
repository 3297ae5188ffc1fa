"""What has no name in a car, as a saved model holds it: functions of its state, and where they were found.

Functions are those of `bcid.effects.remainder`, of the car's own state alone: neither of the place nor of the time, so
that they act on any drive.  Where no drive was, nothing is known of them.
"""

from collections.abc import Mapping
from typing import NamedTuple, Self

import numpy as np

from bcid.aliases import Floats
from bcid.effects.harmonics import AnglePlan, plan_angles
from bcid.effects.remainder_table import COLUMNS, DIRECTION, DIRECTIONS, INPUTS, MOST, OF_THE_CAR, WAVE
from bcid.models.interface import Arrays
from bcid.models.saved_parts import ArrayRule, check_arrays

_LARGEST = 1e6  # of an angle (rad), beyond which the compiled sine is not exact
RULES: Mapping[str, ArrayRule] = {
    "functions": ArrayRule(np.float64, ("functions", COLUMNS), -_LARGEST, _LARGEST),
    "half_waves": ArrayRule(np.float64, (len(INPUTS), 2), -_LARGEST, _LARGEST),
    "driven": ArrayRule(np.float64, (OF_THE_CAR, 2), -_LARGEST, _LARGEST),
}


class UnnamedPart(NamedTuple):
    """Functions without a name, with their coefficients, and the ranges over which a drive went."""

    functions: Floats  # (K, COLUMNS) as in `bcid.effects.remainder`
    half_waves: Floats  # (len(INPUTS), 2) phase (rad) and wave number of half a wave over each range
    driven: Floats  # (OF_THE_CAR, 2) lowest and highest of each of the car's own INPUTS

    @property
    def plan(self) -> AnglePlan:
        """The angles by which the functions are computed."""
        return plan_angles(self.functions, self.half_waves)

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        """The part whose fields are these arrays, as they were saved.

        Raises:
            ValueError: one is no such array, or a function is of the place or the time, or acts in no direction.
        """
        part = cls(**check_arrays(arrays, RULES))
        if len(part.functions) > MOST:
            raise ValueError(f"array functions: {len(part.functions)} of them, {MOST} at most")
        if not np.isin(part.functions[:, DIRECTION], range(len(DIRECTIONS))).all():
            raise ValueError("array functions: one acts in no direction")
        if part.functions[:, WAVE + OF_THE_CAR :].any():
            raise ValueError("array functions: one depends on the place or the time")
        if (part.driven[:, 0] >= part.driven[:, 1]).any():
            raise ValueError("array driven: a range ends before it begins")
        return part

"""Types that every part of the package uses; what an array holds, in which shape and unit, stands with each name."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

Progress = Callable[[float, str], None]
"""What long work calls as it goes on: the share done in [0, 1], and a short text."""

Switches = Any
"""One record of numbers, one for each parameter of every effect (`bcid.effects.table.effect_switches`)."""

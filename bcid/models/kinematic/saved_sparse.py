"""What a saved sparse sum must hold: its facts, and its coefficients and exponents, by which compiled code writes."""

from typing import Any

import numpy as np
from pydantic import Field

from bcid.models.interface import Arrays
from bcid.models.kinematic.library import FACTORS
from bcid.models.kinematic.saved_kinematics import SavedKinematicCar
from bcid.models.kinematic.sparse_sum import SparseEquations
from bcid.models.limits import LIMITS
from bcid.models.saved_parts import ArrayRule, SavedFacts, SavedPart, Undetermined, check_arrays

SPARSE_ARRAYS = {
    **{
        name: ArrayRule(np.float64, (size,), -LIMITS.max_constant, LIMITS.max_constant)
        for name, size in (("xi_v", "n"), ("xi_f", "m"), ("xi_r", "m"))
    },
    **{
        name: ArrayRule(np.int64, (size, len(FACTORS)), 0, LIMITS.max_factors)
        for name, size in (("speed", "n"), ("slip", "m"))
    },
}
"""Each array of a saved K-SINDy: n terms of v_f, m of both slip angles, and the terms' exponents over the factors."""


class SparseFacts(SavedFacts):
    """What is stated of a fit of sparse equations: by equation and term, the share of resamples and an interval."""

    term_confidence: dict[str, dict[str, tuple[Undetermined, Undetermined, Undetermined]]] = Field(default_factory=dict)


class SavedKSindy(SavedPart):
    """The JSON part of a saved K-SINDy; its coefficients and exponents are arrays."""

    frame: SavedKinematicCar
    facts: SparseFacts


class SavedKSindyMlp(SavedPart):
    """The JSON part of a saved K-SINDy-MLP."""

    sindy: SavedKSindy
    facts: dict[str, Any]
    dissipative: bool = False


def equations_from_arrays(arrays: Arrays) -> SparseEquations:
    """The equations whose fields are `arrays`, as they were saved.

    Raises:
        ValueError: an array is not what `SPARSE_ARRAYS` says, or there are more terms, or more factors in a term, than
            LIMITS.max_terms and LIMITS.max_factors.
    """
    equations = SparseEquations(**check_arrays(arrays, SPARSE_ARRAYS))
    for name, exponents in (("speed", equations.speed), ("slip", equations.slip)):
        factors = int(exponents.sum(axis=1).max())
        if len(exponents) > LIMITS.max_terms or factors > LIMITS.max_factors:
            cause = f"{len(exponents)} terms of up to {factors} factors"
            raise ValueError(f"array {name}: {cause}, {LIMITS.max_terms} of {LIMITS.max_factors} are the most")
    return equations

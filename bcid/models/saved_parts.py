"""What a saved model must hold before any compiled kernel sees it: its JSON part field by field, its arrays by name.

Kernels check nothing: an exponent of ten million would be written behind the end of a table, a period of zero divided
by.  So every model declares the class of its JSON part, a `SavedPart` of strict types with bounds, and an `ArrayRule`
for each of its arrays, and its `from_saved` begins with `parse_saved` and `check_arrays`.
"""

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bcid.documents.document import describe_problems
from bcid.estimate.limits import LIMITS as GRID
from bcid.models.interface import Arrays
from bcid.models.limits import LIMITS

Positive = Annotated[float, Field(ge=LIMITS.min_constant, le=LIMITS.max_constant)]
NotNegative = Annotated[float, Field(ge=0.0, le=LIMITS.max_constant)]
Signed = Annotated[float, Field(ge=-LIMITS.max_constant, le=LIMITS.max_constant)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Switch = Annotated[float, Field(ge=0.0, le=1.0, multiple_of=1.0)]
"""A number that is 0 or 1."""
Period = Annotated[float, Field(ge=GRID.min_period_s, le=GRID.max_period_s)]
Undetermined = Annotated[float, Field(allow_inf_nan=True)]
"""A number that is only printed, and may be NaN or infinite where it was not determined."""


class SavedPart(BaseModel):
    """A part of model.json: immutable, no type converted, every number finite, no key unknown."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class SavedFacts(SavedPart):
    """How a model was fitted: what is printed of it has types; further entries, for people, may hold anything."""

    model_config = ConfigDict(extra="allow")

    def as_mapping(self) -> dict[str, Any]:
        """The facts that were saved, by name."""
        return self.model_dump(exclude_unset=True)


P = TypeVar("P", bound=SavedPart)


def parse_saved(kind: type[P], data: Mapping[str, Any]) -> P:
    """The part `kind` of a saved model, from the JSON object `data` of model.json; no type is converted.

    Raises:
        ValueError: there are wrong, missing or unknown entries; the message names them.
    """
    try:
        return kind.model_validate_json(json.dumps(data))
    except ValidationError as error:
        places, causes = describe_problems(error, kind)
        raise ValueError(causes if error.error_count() > 1 else f"{places}: {causes}") from None


class ArrayRule(NamedTuple):
    """What an array of a saved model must be: its type, its sizes, and the range of its numbers."""

    dtype: type[np.generic]
    shape: tuple[int | str, ...]  # a size by its name is the same wherever the name stands
    low: float = -math.inf
    high: float = math.inf


def check_arrays(arrays: Arrays, rules: Mapping[str, ArrayRule]) -> Arrays:
    """The arrays of a saved model, contiguous, after each was found to be as its rule says.

    Raises:
        ValueError: one is missing or unknown, of another type or shape, empty, or has a number that is not finite or
            out of range.
    """
    for name in arrays:
        if name not in rules:
            raise ValueError(f"array {name}: there is no such array, but {', '.join(rules) or 'none'}")
    sizes = dict[str, int]()
    return {name: _check_array(name, arrays.get(name), rule, sizes) for name, rule in rules.items()}


def _check_array(name: str, array: Any, rule: ArrayRule, sizes: dict[str, int]) -> Any:
    """The array `name`, contiguous, checked against its rule; `sizes`, by name, are those of arrays before it."""
    if array is None:
        raise ValueError(f"array {name}: is missing")
    if array.dtype != rule.dtype:
        raise ValueError(f"array {name}: is of {array.dtype}, not of {np.dtype(rule.dtype)}")
    known = {**sizes, **dict(zip(map(str, rule.shape), array.shape, strict=False)), **sizes}
    wanted = tuple(size if isinstance(size, int) else known.get(size, 1) for size in rule.shape)
    if array.shape != wanted or 0 in array.shape:
        raise ValueError(f"array {name}: has the shape {array.shape}, not {wanted}")
    sizes.update({size: known[size] for size in rule.shape if isinstance(size, str)})
    low, high = array.min(), array.max()  # NaN where one of the numbers is
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ValueError(f"array {name}: holds a number that is not finite")
    if low < rule.low or high > rule.high:
        raise ValueError(f"array {name}: holds {low:g} to {high:g}, not within {rule.low:g} to {rule.high:g}")
    return np.ascontiguousarray(array)

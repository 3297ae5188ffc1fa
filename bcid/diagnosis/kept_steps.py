"""Steps of a search that are kept while a proof repeats it with one limit changed.

A step is kept under its arguments and the values of the limits that it reads: where another is changed it is the same
to the last bit, and is looked up (`bcid.likelihood.kept_fits`).
"""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from bcid.diagnosis.limits import DECIDING_LIMITS
from bcid.likelihood.kept_fits import kept_in_proofs

P = ParamSpec("P")
T = TypeVar("T")

READ_LIMITS: dict[str, tuple[str, ...]] = {}
"""Which of the deciding limits each kept step reads, by its name."""


def kept_under(*limits: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorator: a function that depends on its arguments and on these of DECIDING_LIMITS only, itself or by others."""

    def keep(step: Callable[P, T]) -> Callable[P, T]:
        READ_LIMITS[step.__qualname__] = limits
        return kept_in_proofs(step, lambda: tuple(getattr(DECIDING_LIMITS[name], name) for name in limits))

    return keep

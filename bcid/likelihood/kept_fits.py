"""Refits that are kept while a proof repeats one search many times, each time with a little changed.

A refit is a pure function: of equal arguments it is the same fit to the last bit, whatever limits a search has, which
no module of such a function may read (steps of a search that do stand in `bcid.diagnosis.kept_steps`).  Nothing is
kept, or looked up, outside of `use_kept_fits`.
"""

import dataclasses
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")

LARGE = 100_000
"""Numbers in an array from which it is known by its identity, not by its content: that would take too long."""


@dataclass
class KeptFits:
    """Fits by the arguments of which they were made, which are kept with them, so that no identity is used again."""

    is_open: bool = True  # fits are added; afterwards they are only looked up
    by_arguments: dict[Hashable, tuple[Any, Any]] = field(default_factory=dict)
    looked_up: int = 0  # times that a fit was there


_in_use: list[KeptFits] = []


@contextmanager
def use_kept_fits(kept: KeptFits) -> Iterator[None]:
    """Context manager: in its block refits are looked up in `kept`, and added to it while it is open.

    It holds for all threads of the process.
    """
    _in_use.append(kept)
    try:
        yield
    finally:
        _in_use.pop()


def kept_in_proofs(compute: Callable[P, T], beside: Callable[[], Hashable] = lambda: None) -> Callable[P, T]:
    """Decorator: a pure function that makes fits, which `use_kept_fits` keeps.

    What else it depends on than its arguments is what `beside` returns.
    """

    @wraps(compute)
    def look_up_or_compute(*args: P.args, **kwargs: P.kwargs) -> T:
        if not _in_use:
            return compute(*args, **kwargs)
        kept, key = _in_use[-1], (compute.__qualname__, beside(), content_key((args, kwargs)))
        if key in kept.by_arguments:
            kept.looked_up += 1
            result: T = kept.by_arguments[key][1]
            return result
        result = compute(*args, **kwargs)
        if kept.is_open:
            kept.by_arguments[key] = ((args, kwargs), result)
        return result

    return look_up_or_compute


def content_key(value: Any) -> Hashable:
    """A key that is equal for values of equal content: numbers, texts, arrays, and what is made of them.

    LARGE arrays, and objects that are no data, count as equal only if they are the same one.
    """
    if isinstance(value, np.ndarray):
        return id(value) if value.size > LARGE else (value.shape, value.dtype.str, value.tobytes())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return (type(value), *(content_key(getattr(value, f.name)) for f in dataclasses.fields(value)))
    if isinstance(value, Mapping):
        return (type(value), *((content_key(k), content_key(v)) for k, v in value.items()))
    if isinstance(value, tuple | list):
        return (type(value), *map(content_key, value))
    if isinstance(value, np.generic):
        return content_key(value.item())
    return value if isinstance(value, int | float | str | bytes | None) else id(value)

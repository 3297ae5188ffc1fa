"""Predictions that leave the finite numbers: where that is raised, where it is passed over, and where it is refused."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused, PredictionDiverged
from bcid.recording.types import Recording

P = ParamSpec("P")
T = TypeVar("T")


def require_finite(what: str, *arrays: Floats) -> None:
    """Raise `PredictionDiverged` ("`what` left the finite numbers") if any of the arrays has a NaN or an infinity."""
    if not all(np.isfinite(array).all() for array in arrays):
        raise PredictionDiverged(f"{what} left the finite numbers")


def none_if_diverged(compute: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
    """The result of `compute(*args, **kwargs)`, or None if it raises `PredictionDiverged` (not a finite prediction)."""
    try:
        return compute(*args, **kwargs)
    except PredictionDiverged:
        return None


def map_converged(
    compute: Callable[..., T], arguments: Iterable[tuple[Any, ...]], required: bool = False
) -> Iterator[T]:
    """Yield `compute(*args)` for each tuple of `arguments`, skipping those for which it raises `PredictionDiverged`.

    Raises:
        PredictionDiverged: the last one skipped, if a result is `required` and no call gave one.
    """
    error: PredictionDiverged | None = None
    for args in arguments:
        try:
            yield compute(*args)
            required = False
        except PredictionDiverged as diverged:
            error = diverged
    if required and error is not None:
        raise error


@contextmanager
def refuse_divergence(recordings: Sequence[Recording]) -> Iterator[None]:
    """Context manager: turns `PredictionDiverged` or failed linear algebra raised in its block into `InputRefused`.

    The message names the first of the `recordings` and says that the model cannot follow their motion.
    """
    try:
        yield
    except (PredictionDiverged, np.linalg.LinAlgError) as error:
        source = recordings[0].sources[0].path if recordings else "recordings"
        raise InputRefused(
            source, "poses and commands", f"the model cannot follow them: {error}",
            "check the vehicle file's mass, distances and limits, and the recording's units",
        ) from error  # fmt: skip

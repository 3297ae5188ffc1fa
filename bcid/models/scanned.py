"""A model's rollouts by its compiled kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np

from bcid.models.interface import Floats


class Kernels(NamedTuple):
    """Both take carries on in place, to behind the last command, and return the twists after each."""

    scan: Callable[..., Floats]  # (carry (n,), commands (N, 2), *arguments) -> (N, 3)
    scan_many: Callable[..., Floats]  # (carries (B, n), commands (B, N, 2), *arguments) -> (B, N, 3), on all cores


class Scanned:
    """`step`, `scan` and `scan_many` of a model that has `kernels` and the `arguments` they take."""

    kernels: ClassVar[Kernels]
    motion: ClassVar[slice] = slice(0, 3)

    @property
    def arguments(self) -> tuple[Any, ...]:
        """What the kernels take beside carries and commands."""
        raise NotImplementedError

    def step(self, carry: Floats, command: Floats) -> tuple[Floats, Floats]:
        """See `Model.step`."""
        after, twists = self.scan(carry, np.asarray(command, dtype=np.float64)[None])
        return after, twists[0]

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """See `Model.scan`."""
        after = np.array(carry, dtype=np.float64)
        return after, self.kernels.scan(after, np.ascontiguousarray(commands, dtype=np.float64), *self.arguments)

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """See `Model.scan_many`."""
        after = np.array(carries, dtype=np.float64, order="C")
        return after, self.kernels.scan_many(after, np.ascontiguousarray(commands, dtype=np.float64), *self.arguments)

"""What pools of tests share, which have nothing to end."""

from __future__ import annotations

from types import TracebackType
from typing import Self


class FakePool:
    """A pool that begins and ends nothing as it is entered and left."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing is left to be ended."""

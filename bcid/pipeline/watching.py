"""Who follows a pipeline's stages as they are made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from bcid.aliases import Progress


class Watcher(Protocol):
    """Who is told of the stages: each is entered when it starts, and told whether it was reused."""

    def stage(self, title: str) -> AbstractContextManager[Progress]:
        """A stage that is about to be made."""

    def reused(self, title: str) -> None:
        """A stage that was found in the cache."""

    def note(self, text: str) -> None:
        """Something that a person may want to know."""


class Silent:
    """A watcher that says nothing."""

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        """See `Watcher`."""
        yield lambda share, text: None

    def reused(self, title: str) -> None:
        """See `Watcher`."""

    def note(self, text: str) -> None:
        """See `Watcher`."""

"""Watchers, which follow a pipeline's stages as they run."""

from collections.abc import Iterator
from contextlib import contextmanager

from bcid.aliases import Progress


class Watcher:
    """Follows a pipeline's stages as they run; this one shows nothing, its subclasses do."""

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        """Enter a stage that starts now; yields what the stage calls with its progress."""
        yield lambda share, text: None

    def report_reused(self, title: str) -> None:
        """Tell that a stage was found in the cache."""

    def note(self, text: str) -> None:
        """Tell something that a person may want to know."""

    def report_locked(self, text: str) -> None:
        """Tell that another run is at work on what is needed next; the pipeline waits for it once this returns.

        A watcher that raises an error here does not let the pipeline wait.
        """
        self.note(text)


class NotingWatcher(Watcher):
    """Keeps what a person should be told, where nobody looks on; that it waited is of no use afterwards."""

    def __init__(self) -> None:
        """Nothing was noted yet."""
        self.notes = list[str]()

    def note(self, text: str) -> None:
        """Keep it."""
        self.notes.append(text)

    def report_locked(self, text: str) -> None:
        """Let the pipeline wait."""

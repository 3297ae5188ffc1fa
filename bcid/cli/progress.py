"""How far a stage is: a share that only grows, the time it took, an estimate of what is left; as a bar or as lines."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as ProgressBar

from bcid.aliases import Progress
from bcid.cli.limits import LIMITS
from bcid.errors import printable


class StageProgress:
    """The share of a stage that is done, which never falls, and the text that came with it."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin a stage now, by a `clock` that gives seconds."""
        self._clock, self._begin_s = clock, clock()
        self.share, self.text = 0.0, ""

    def advance(self, share: float, text: str) -> None:
        """Take over what a stage says of itself; a share below the one reached already, or NaN, changes the text only.

        The time that a stage has left is computed from the share and the time at which that share was reached.
        """
        if share > self.share:
            self.share, self._reached_s = min(share, 1.0), self._clock()
        self.text = printable(text, "")

    @property
    def elapsed_s(self) -> float:
        """The time (s) since the stage began."""
        return self._clock() - self._begin_s

    @property
    def left_s(self) -> float | None:
        """The time (s) that the rest takes if it goes on as so far; None while nobody can say, and when it is over.

        It falls with the time that goes by, and is never less than nothing.
        """
        if not LIMITS.min_share_to_extrapolate <= self.share < 1.0:
            return None
        took = self._reached_s - self._begin_s
        left = took * (1.0 - self.share) / self.share - (self._clock() - self._reached_s)
        return left if left > 0.0 else None

    def describe_times(self) -> str:
        """The time so far and the time left, in words: "1 min 20 s, about 3 min left"."""
        left = self.left_s
        so_far = format_duration(self.elapsed_s)
        return so_far if left is None else f"{so_far}, about {format_duration(_round_coarsely(left))} left"


def format_duration(seconds: float) -> str:
    """A time in words.

    >>> format_duration(7.4), format_duration(80.0), format_duration(7260.0), format_duration(120.0)
    ('7 s', '1 min 20 s', '2 h 1 min', '2 min')
    """
    whole = round(seconds)
    if whole >= 3600:
        hours, minutes = divmod(round(whole / 60), 60)
        return f"{hours} h" + (f" {minutes} min" if minutes else "")
    minutes, rest = divmod(whole, 60)
    return " ".join([f"{minutes} min"] * bool(minutes) + [f"{rest} s"] * bool(rest or not minutes))


def _round_coarsely(seconds: float) -> float:
    """An estimated time to no more digits than it deserves: whole minutes above two, tens of seconds above ten."""
    step = 60.0 if seconds > 120.0 else 10.0 if seconds > 10.0 else 1.0
    return max(step * round(seconds / step), 1.0)


@contextmanager
def show_bar(title: str, console: Console) -> Iterator[Progress]:
    """Show a running stage on a terminal as a bar with its times, then as one line with the time it took."""
    done, title = StageProgress(), printable(title, "")
    with ProgressBar(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[text]}"), _Times(done),
        console=console, transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task(escape(title), total=None, text="")

        def advance(share: float, text: str) -> None:
            done.advance(share, text)
            total = 1.0 if done.share > 0.0 else None
            bar.update(task, completed=done.share, total=total, text=escape(done.text))

        yield advance
    console.print(f"{escape(title):32} {done.elapsed_s:6.1f} s")


class _Times(TextColumn):
    """The column of a bar that says how long the stage has taken, and how long the rest will take."""

    def __init__(self, done: StageProgress) -> None:
        """Show the times of the stage `done`."""
        super().__init__("")
        self._done = done

    def render(self, task: object) -> object:  # type: ignore[override]
        """The times now; a bar is drawn anew several times a second."""
        from rich.text import Text

        return Text(self._done.describe_times(), style="progress.elapsed")


@contextmanager
def print_lines(title: str, console: Console) -> Iterator[Progress]:
    """Print how far a stage is where nobody watches a bar: a line now and then, and none of a stage that is soon over.

    A line comes with each tenth of the work, and at least every LIMITS.line_every_s, whether the stage says
    anything or not: a thread of its own waits for that.
    """
    done, over, title = StageProgress(), threading.Event(), printable(title, "")
    last = {"tenth": 0, "at_s": 0.0, "lines": 0}

    def print_now() -> None:
        last.update(tenth=int(10 * done.share), at_s=done.elapsed_s, lines=last["lines"] + 1)
        share = f"{100 * done.share:.0f} % " if done.share > 0.0 else ""
        what = f" ({done.text})" if done.text else ""
        console.print(escape(f"{title}: {share}after {done.describe_times()}{what}"))

    def print_while_it_runs() -> None:
        while not over.wait(LIMITS.min_line_gap_s):
            new_tenth = int(10 * done.share) > last["tenth"]
            if new_tenth or done.elapsed_s - last["at_s"] >= LIMITS.line_every_s:
                print_now()

    def advance(share: float, text: str) -> None:
        done.advance(share, text)

    thread = threading.Thread(target=print_while_it_runs, daemon=True)
    thread.start()
    try:
        yield advance
    finally:
        over.set()
        thread.join()
    if last["lines"]:
        console.print(escape(f"{title}: done after {format_duration(done.elapsed_s)}"))

"""Where output goes: results to stdout, progress and messages to stderr; human, json or quiet."""

from __future__ import annotations

import io
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from typing import Any

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

PIPED_WIDTH = 4096  # nothing is cut in a pipe


class Format(StrEnum):
    """How results are written."""

    human = "human"
    json = "json"
    quiet = "quiet"


def _finite(value: Any) -> Any:
    """The same with NaN and infinities as null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    return [_finite(v) for v in value] if isinstance(value, list | tuple) else value


def _inert(text: str) -> str:
    """The text without control characters, which a terminal might obey."""
    return "".join(c if c.isprintable() or c == "\n" else "�" for c in text)


class Sink:
    """One output for all commands."""

    def __init__(self, style: Format) -> None:
        self.style = style
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # a Windows pipe may not know δ
        colourless = "NO_COLOR" in os.environ
        self.out = Console(no_color=colourless, highlight=False, width=None if sys.stdout.isatty() else PIPED_WIDTH)
        self.err = Console(stderr=True, no_color=colourless, soft_wrap=True, highlight=False)
        self.lively = self.err.is_terminal and style is not Format.quiet

    def result(self, data: dict[str, Any], human: Callable[[], str | RenderableType]) -> None:
        """A command's result: `data` as JSON, or what `human` returns for people."""
        if self.style is Format.json:
            print(json.dumps(_finite(data), indent=1))  # noqa: T201  # results, and nothing else, are printed here
        elif self.style is Format.human:
            shown = human()
            if isinstance(shown, str):
                print(_inert(shown))  # noqa: T201
            else:
                self.out.print(shown)

    def note(self, text: str) -> None:
        """A message for people, on stderr."""
        if self.style is Format.human:
            self.err.print(escape(_inert(text)))

    def told(self, text: str) -> None:
        """What must be said before a result, in every format, on stderr."""
        self.err.print(escape(_inert(text)), highlight=False, soft_wrap=True)

    def error(self, text: str) -> None:
        """An error, in every format."""
        self.err.print(f"[red]error:[/red] {escape(_inert(text))}")

    @contextmanager
    def stage(self, title: str) -> Iterator[Callable[[float, str], None]]:
        """A stage that is being made: a bar on a terminal, nothing where stderr is piped."""
        if not self.lively:
            yield lambda share, text: None
            return
        begin = time.perf_counter()
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[text]}"),
            TimeElapsedColumn(),
        )
        with Progress(*columns, console=self.err, transient=True) as bar:
            task = bar.add_task(escape(title), total=None, text="")

            def advance(share: float, text: str) -> None:
                bar.update(task, completed=share, total=1.0 if share > 0 else None, text=escape(text))

            yield advance
        self.err.print(f"{escape(title):32} {time.perf_counter() - begin:6.1f} s")

    def reused(self, title: str) -> None:
        """A stage found in the cache."""
        if self.lively:
            self.err.print(f"[dim]{escape(title):32} cached[/dim]")


def table(title: str, columns: list[str], rows: list[list[str]], caption: str = "", texts: Sequence[str] = ()) -> Table:
    """A plain table; the first column and `texts` left, the others right."""
    made = Table(
        title=escape(title), title_justify="left", caption=escape(caption), caption_justify="left", box=None,
        pad_edge=False, header_style="bold",
    )  # fmt: skip
    for i, name in enumerate(columns):
        made.add_column(name, justify="left" if i == 0 or name in texts else "right")
    for row in rows:
        made.add_row(*(escape(_inert(cell)) for cell in row))
    return made


def thousandths(value: float | None) -> str:
    """An NMSE as a multiple of 10^-3; "diverged" for none."""
    if value is None:
        return "diverged"
    return f"{1e3 * value:.{2 if value < 1.0 else 0}f}" if value < 100.0 else f"{1e3 * value:.1e}"

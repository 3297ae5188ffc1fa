"""Where output goes: results to stdout, progress and messages to stderr; for people, as JSON, or quiet."""

import io
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from bcid.aliases import Progress
from bcid.cli.options import Format
from bcid.cli.progress import print_lines, show_bar
from bcid.errors import OutputClosed, printable
from bcid.pipeline.watching import Watcher

PIPED_WIDTH = 4096  # nothing is cut in a pipe


class CleanConsole(Console):
    """A console that prints no control character of any text it is given, whatever file or person the text is from."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Text to print, from a string that may hold markup."""
        return super().render_str(printable(text), **options)


def _nonfinite_to_none(value: Any) -> Any:
    """A copy of nested JSON data with None in place of NaN and infinities."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {k: _nonfinite_to_none(v) for k, v in value.items()}
    return [_nonfinite_to_none(v) for v in value] if isinstance(value, list | tuple) else value


class Sink(Watcher):
    """The output of a command, and the watcher of its pipeline."""

    def __init__(self, style: Format) -> None:
        """Prepare stdout and stderr for results in the format `style`."""
        self.style = style
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # a Windows pipe may not know δ
        colourless = "NO_COLOR" in os.environ
        width = None if sys.stdout.isatty() else PIPED_WIDTH
        self.out = CleanConsole(no_color=colourless, highlight=False, width=width)
        self.err = CleanConsole(stderr=True, no_color=colourless, soft_wrap=True, highlight=False)
        self.lively = self.err.is_terminal and style is not Format.quiet

    def result(self, data: dict[str, Any], human: Callable[[], str | RenderableType]) -> None:
        """Print a command's result: `data` as JSON, or what `human` returns for people.

        Raises:
            OutputClosed: nobody reads it.
        """
        shown = human() if self.style is Format.human else ""
        try:
            if self.style is Format.json:
                print(json.dumps(_nonfinite_to_none(data), indent=1))  # noqa: T201  # results, and nothing else
            elif isinstance(shown, str) and self.style is Format.human:
                print(printable(shown))  # noqa: T201
            elif self.style is Format.human:
                self.out.print(shown)
            sys.stdout.flush()
        except BrokenPipeError:
            raise OutputClosed from None

    def note(self, text: str, in_every_format: bool = False) -> None:
        """Print a message for people on stderr; in other formats only what must be known before the result."""
        if in_every_format or self.style is Format.human:
            self.err.print(escape(text))

    def error(self, text: str) -> None:
        """Print an error on stderr, in every format."""
        self.err.print(f"[red]error:[/red] {escape(text)}")

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        """Show a stage that is running: a bar on a terminal, lines for people elsewhere, nothing in other formats."""
        if self.lively:
            with show_bar(title, self.err) as progress:
                yield progress
        elif self.style is Format.human:
            with print_lines(title, self.err) as progress:
                yield progress
        else:
            yield lambda share, text: None

    def report_reused(self, title: str) -> None:
        """Show that a stage was found in the cache."""
        if self.lively:
            self.err.print(f"[dim]{escape(printable(title, '')):32} cached[/dim]")


_FIGURE = re.compile(r"[-+−±≤≥<>(~]*\s*\d|[–—]?$")
"""How a cell begins that holds a figure, or nothing."""


def is_column_of_figures(cells: Sequence[str]) -> bool:
    """Whether a column is one of figures, which are compared digit by digit: each cell is one or is empty, not all are.

    >>> is_column_of_figures(["0.33", "–", "1.2 ± 0.1 N"]), is_column_of_figures(["newton-euler", "12"])
    (True, False)
    """
    return all(_FIGURE.match(cell.strip()) for cell in cells) and any(c.strip(" –—") for c in cells)


def plain_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> Table:
    """A table without ruling lines: columns of figures aligned right, texts and the first column left."""
    made = Table(
        title=escape(title), title_justify="left", caption=escape(caption), caption_justify="left", box=None,
        pad_edge=False, header_style="bold",
    )  # fmt: skip
    for i, name in enumerate(columns):
        figures = i > 0 and is_column_of_figures([row[i] for row in rows])
        made.add_column(name, justify="right" if figures else "left")
    for row in rows:
        # a cell is one line, so that no name in it can begin another
        made.add_row(*(escape(printable(cell, "")) for cell in row))
    return made

"""`bcid bench`: how fast the hot paths are beside their peers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from bcid.cli.options import FormatOption
from bcid.cli.sink import Format, Sink
from bcid.errors import GoalMissed, UsageError


def bench(
    only: Annotated[list[str] | None, typer.Option("--only", help="One path, or several. Default: all.")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Turns that each way of doing it takes.")] = 15,
    check: Annotated[bool, typer.Option("--check", help="End with exit code 5 where a goal is missed.")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="A file for the JSON.")] = None,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Time every hot path against its named peer, in one process and in turns."""
    from bcid.bench.run import PATHS, outcome, run
    from bcid.cli import show
    from bcid.report.content import machine

    strange = [name for name in only or [] if name not in PATHS]
    if strange:
        raise UsageError(f"there is no path {strange[0]!r}\n  next: choose from {', '.join(PATHS)}")
    sink, rows = Sink(format), []
    names = only or list(PATHS)
    with sink.stage("bench") as progress:
        for k, name in enumerate(names):
            progress(k / len(names), name)
            rows += list(run([name], repeats))
    found = outcome(rows, repeats, machine())
    if out is not None:
        out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    sink.result(found, lambda: show.bench(found))
    missed = [f"{row.path} against {row.peer}" for row in rows if row.missed]
    if check and missed:
        raise GoalMissed(f"goals missed ({'; '.join(missed)})\n  next: run it on an idle machine, or see the ratios")

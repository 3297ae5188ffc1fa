"""`bcid bench`: how fast the hot paths, how accurate the models, how honest the intervals are."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import RenderableType

from bcid.aliases import Progress
from bcid.cli.options import FormatOption
from bcid.cli.sink import Format, Sink
from bcid.errors import GoalMissed, UsageError

ACCURACY = Path("pipelines/accuracy.toml")


class What(StrEnum):
    """What is measured."""

    speed = "speed"
    accuracy = "accuracy"
    parameters = "parameters"


def bench(
    what: Annotated[
        What,
        typer.Argument(
            help="speed: hot paths beside their peers. accuracy: models beside peers on unseen takes. "
            "parameters: how often the stated intervals of a simulated car's constants hold."
        ),
    ] = What.speed,
    only: Annotated[list[str] | None, typer.Option("--only", help="speed: one path, or several. Default: all.")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="speed: turns that each way of doing it takes.")] = 15,
    seeds: Annotated[int, typer.Option(min=1, help="accuracy: fits of each model.")] = 3,
    data: Annotated[Path, typer.Option("--data", help="accuracy: the file of data.")] = ACCURACY,
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="accuracy: the folder of the real recordings.")
    ] = None,
    workspace: Annotated[
        Path | None, typer.Option("--workspace", help="accuracy: where takes and fits are kept.")
    ] = None,
    fits: Annotated[int, typer.Option(min=1, help="parameters: takes that are fitted.")] = 40,
    seconds: Annotated[float, typer.Option(min=40.0, help="parameters: length of each.")] = 60.0,
    check: Annotated[bool, typer.Option("--check", help="End with exit code 5 where a goal is missed.")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="A file for the JSON.")] = None,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Measure: speed against named peers, in one process and in turns; accuracy; how often intervals hold."""
    from bcid.cli import show

    sink = Sink(format)
    shown: Callable[[Mapping[str, Any]], RenderableType]
    with sink.stage(f"bench {what.value}") as progress:
        if what is What.speed:
            found, shown = _speed(only or [], repeats, progress), show.bench
        elif what is What.accuracy:
            found, shown = _accuracy(data, recordings, workspace, seeds, progress), show.accuracy
        else:
            found, shown = _parameters(fits, seconds, progress), show.recovery
    if out is not None:
        out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    sink.result(found, lambda: shown(found))
    if check and found["missed"]:
        raise GoalMissed(
            f"goals missed ({'; '.join(found['missed'])})\n  next: run it on an idle machine, or see the table"
        )


def _speed(only: list[str], repeats: int, progress: Progress) -> dict[str, Any]:
    from bcid.bench.run import PATHS, outcome, run
    from bcid.report.content import machine

    strange = [name for name in only if name not in PATHS]
    if strange:
        raise UsageError(f"there is no path {strange[0]!r}\n  next: choose from {', '.join(PATHS)}")
    rows, names = [], only or list(PATHS)
    for k, name in enumerate(names):
        progress(k / len(names), name)
        rows += list(run([name], repeats))
    return outcome(rows, repeats, machine())


def _accuracy(
    data: Path, recordings: Path | None, workspace: Path | None, seeds: int, progress: Progress
) -> dict[str, Any]:
    from bcid.bench.accuracy import compared, outcome, plans
    from bcid.bench.run import versions
    from bcid.report.content import machine

    if workspace is None:
        raise UsageError("accuracy keeps its takes and fits\n  next: name a folder with --workspace")
    rows = []
    for name, plan in plans(data, recordings, workspace):
        for row in compared(name, plan, range(1, seeds + 1)):
            rows.append(row)
            progress(0.0, f"{name}, {row['model']}, seed {row['seed']}")
    if not rows:
        raise UsageError(f"{data} names real recordings only\n  next: name their folder with --recordings")
    return outcome(rows, {"machine": machine(), "versions": versions()})


def _parameters(fits: int, seconds: float, progress: Progress) -> dict[str, Any]:
    from bcid.bench.parameters import outcome, recovery
    from bcid.report.content import machine

    rows = []
    for k, found in enumerate(recovery(fits, seconds, 1, os.cpu_count() or 1)):
        rows += found
        progress((k + 1) / fits, f"take {k + 1}")
    return outcome(rows, {"machine": machine(), "fits": fits, "seconds": seconds})

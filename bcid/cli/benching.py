"""`bcid bench`: how fast the hot paths are, how accurate the models, how often stated intervals hold."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bcid.cli.options import DaskOption, ForceOption, Format, FormatOption, choose_workers
from bcid.errors import GoalMissed, UsageError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bcid.aliases import Progress
    from bcid.execution.jobs import Workers

OTHER_FILE = "name another file with --out"
DEFAULT_FLEETS = [4, 16]
ACCURACY_FILE = Path("pipelines/accuracy.toml")


class BenchSubject(StrEnum):
    """What `bcid bench` measures."""

    speed = "speed"
    accuracy = "accuracy"
    parameters = "parameters"
    fleet = "fleet"


def bench(
    what: Annotated[
        BenchSubject,
        typer.Argument(
            help="speed: hot paths beside their peers. accuracy: models beside peers on unseen takes. "
            "parameters: how often the stated intervals of a simulated car's constants hold. "
            "fleet: what a log costs as fleets grow."
        ),
    ] = BenchSubject.speed,
    only: Annotated[
        list[str] | None, typer.Option("--only", help="speed: a path to time; repeat for several. Default: all.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="speed: turns that we and each peer take.")] = 15,
    seeds: Annotated[int, typer.Option(min=1, help="accuracy: fits of each model.")] = 3,
    data: Annotated[Path, typer.Option("--data", help="accuracy: the TOML file of the data.")] = ACCURACY_FILE,
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="accuracy: the folder of the real recordings.")
    ] = None,
    workspace: Annotated[
        Path | None, typer.Option("--workspace", help="accuracy: the folder for takes and fits.")
    ] = None,
    workers: Annotated[
        int,
        typer.Option(
            min=0, help="accuracy, fleet: fits or logs at a time; 0 for as many as cores. Times of fits need 1."
        ),
    ] = 1,
    dask: DaskOption = None,
    fits: Annotated[int, typer.Option(min=1, help="parameters: number of simulated takes to fit.")] = 40,
    seconds: Annotated[float, typer.Option(min=40.0, help="parameters, fleet: length of each take in seconds.")] = 60.0,
    logs: Annotated[
        list[int] | None,
        typer.Option("--logs", min=2, help="fleet: logs of a fleet; repeat for several. Default: 4, 16."),
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="End with exit code 5 where a goal is missed.")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="Write the JSON into this file as well.")] = None,
    renew: Annotated[
        bool, typer.Option("--renew", help="speed: keep the rows in the file --out of all paths but those of --only.")
    ] = False,
    force: ForceOption = False,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Compare speed or accuracy with other libraries, count how often intervals hold, or weigh what fleets cost."""
    from bcid.cli import show
    from bcid.cli.sink import Sink
    from bcid.files.outputs import refuse_to_overwrite, write_output

    if what not in (BenchSubject.accuracy, BenchSubject.fleet) and (workers != 1 or dask is not None):
        raise UsageError("--workers and --dask go with accuracy and fleet\n  next: leave them out")
    sink = Sink(format)
    earlier = _read_earlier(what, only, out) if renew else None
    if out is not None:
        refuse_to_overwrite([out], lambda path: force or renew, OTHER_FILE)
    shown: Callable[[Mapping[str, Any]], RenderableType]
    with sink.stage(f"bench {what.value}") as progress:
        if what is BenchSubject.speed:
            found, shown = _measure_speed(only or [], repeats, progress, earlier, out), show.speed_table
        elif what is BenchSubject.accuracy:
            places = choose_workers(0 if dask is not None and workers == 1 else workers, dask)
            found, shown = _measure_accuracy(data, recordings, workspace, seeds, places, progress), show.accuracy_tables
        elif what is BenchSubject.fleet:
            found = _measure_fleets(logs or DEFAULT_FLEETS, seconds, workers or os.cpu_count() or 1, dask, progress)
            shown = show.fleet_cost_table
        else:
            found, shown = _measure_coverage(fits, seconds, progress), show.coverage_table
    if out is not None:
        text = json.dumps(found, indent=1)
        write_output(out, lambda path: path.write_text(text, encoding="utf-8"), lambda path: force or renew, OTHER_FILE)
    sink.result(found, lambda: shown(found))
    if check and found["missed"]:
        missed = "; ".join(found["missed"])
        raise GoalMissed(f"goals missed ({missed})\n  next: run it on an idle machine, or see the table")


def _read_earlier(what: BenchSubject, only: list[str] | None, out: Path | None) -> dict[str, Any]:
    """The timings in the file `out`, some of which are to be renewed."""
    from bcid.bench.renewal import read_timings

    if what is not BenchSubject.speed or not only or out is None:
        raise UsageError("--renew needs what to renew, and where\n  next: bcid bench --only PATH --out FILE --renew")
    return read_timings(out)


def _measure_speed(
    only: list[str], repeats: int, progress: Progress, earlier: dict[str, Any] | None, out: Path | None
) -> dict[str, Any]:
    """Time the hot paths (rollouts, filters, fits) named in `only`, or all, in turns with other libraries.

    Returns the benchmark's JSON (`bcid.bench/1`): medians of `repeats` turns, their ratios, and the goals missed;
    beside them the other rows of `earlier`, what is in the file `out`.
    """
    from bcid.bench.renewal import renew_timings
    from bcid.bench.run import HOT_PATHS, summarise_timings
    from bcid.report.content import describe_machine

    strange = [name for name in only if name not in HOT_PATHS]
    if strange:
        raise UsageError(f"there is no path {strange[0]!r}\n  next: choose from {', '.join(HOT_PATHS)}")
    timed, names = {}, list(dict.fromkeys(only)) or list(HOT_PATHS)
    for k, name in enumerate(names):
        progress(k / len(names), name)
        timed[name] = list(HOT_PATHS[name](repeats))
    found = summarise_timings(timed, repeats, describe_machine().as_json())
    return found if earlier is None or out is None else renew_timings(earlier, found, names, out)


def _measure_accuracy(
    data: Path, recordings: Path | None, workspace: Path | None, seeds: int, workers: Workers, progress: Progress
) -> dict[str, Any]:
    """Fit our models and other libraries' to each data set of the TOML file `data`, once for each of `seeds` seeds.

    Returns the benchmark's JSON, with the closed-loop NMSE of each model on a validation take.  The folder
    `recordings` holds real takes, `workspace` keeps simulated takes and fits.
    """
    from bcid.bench.accuracy import compare_models, read_accuracy_file, summarise_accuracy
    from bcid.bench.run import library_versions
    from bcid.report.content import describe_machine

    if workspace is None:
        raise UsageError("accuracy keeps its takes and fits\n  next: name a folder with --workspace")
    rows = []
    for name, plan in read_accuracy_file(data, recordings, workspace):
        for row in compare_models(name, plan, range(1, seeds + 1), workers):
            rows.append(row)
            progress(0.0, f"{name}, {row['model']}, seed {row['seed']}")
    if not rows:
        raise UsageError(f"{data} names real recordings only\n  next: name their folder with --recordings")
    return summarise_accuracy(rows, {"machine": describe_machine().as_json(), "versions": library_versions()})


def _measure_fleets(
    counts: list[int], seconds: float, workers: int, dask: str | None, progress: Progress
) -> dict[str, Any]:
    """Run fleets of simulated logs, and return the benchmark's JSON: what a log costs as they grow."""
    from bcid.bench.fleets import measure_fleets, summarise_fleets
    from bcid.report.content import describe_machine

    costs = measure_fleets(counts, seconds, workers, dask, progress)
    return summarise_fleets(costs, seconds, describe_machine().as_json())


def _measure_coverage(fits: int, seconds: float, progress: Progress) -> dict[str, Any]:
    """Fit the car's constants to `fits` takes, each simulated for `seconds`; count how often 95 % intervals hold."""
    from bcid.bench.parameters import fit_simulated_takes, summarise_recovery
    from bcid.report.content import describe_machine

    rows = []
    for k, found in enumerate(fit_simulated_takes(fits, seconds, 1, os.cpu_count() or 1)):
        rows += found
        progress((k + 1) / fits, f"take {k + 1}")
    return summarise_recovery(rows, {"machine": describe_machine().as_json(), "fits": fits, "seconds": seconds})

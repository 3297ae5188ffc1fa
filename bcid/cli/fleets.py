"""`bcid fleet`: everything, of any number of logs, in the processes of this machine or of a Dask cluster."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bcid.cli import options
from bcid.cli.completion import complete_fittable_models
from bcid.cli.options import Format
from bcid.errors import PartLost, UsageError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bcid.documents.fleet import FleetDocument, FleetLog

FLEET_FILE, FLEET_PAGE = "fleet.json", "fleet.html"
USUAL_MODEL = "newton-euler"
SHOWN_NAMES = 5
"""Names of files that a note lists."""


def fleet(
    logs: Annotated[
        list[Path], typer.Argument(help="Logs of one vehicle, and folders of such logs.", show_default=False)
    ],
    model: Annotated[
        list[str] | None,
        typer.Option(
            "--model", "-m", help=f"A model to fit to each log; repeat for several. Default: {USUAL_MODEL}.",
            autocompletion=complete_fittable_models,
        ),
    ] = None,
    diagnose: Annotated[
        bool, typer.Option("--diagnose/--no-diagnose", help="Whether each log is diagnosed, which takes minutes.")
    ] = True,
    jobs: Annotated[
        int, typer.Option(min=0, help="Logs that are worked on at a time; 0 for as many as there are cores.")
    ] = 0,
    labels: Annotated[
        Path | None,
        typer.Option(
            help="A CSV table with the columns log, day and car: when each log was driven, and by which car. Default: "
            "the date in a log's name or folder."
        ),
    ] = None,
    simulation: options.SimulationOption = None,
    dask: options.DaskOption = None,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    effects: options.EffectsOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:  # fmt: skip
    """Ingest, estimate, fit, evaluate and diagnose each of any number of logs by itself; say what all show together.

    A log's results are those of single commands that name it.  Its models are evaluated on the next log.  Together logs
    show which effect the cars have since which day, and which parameters are others.  What fails is named at the end,
    and the others go on; the same command continues where it was stopped.
    """
    from bcid.cli.sink import Sink
    from bcid.execution.jobs import make_pool
    from bcid.fleet.labels import label_logs
    from bcid.fleet.logs import find_logs
    from bcid.fleet.run import run_fleet
    from bcid.fleet.tasks import FleetOrder
    from bcid.models.table import fittable_row
    from bcid.pipeline.run import Pipeline
    from bcid.pipeline.takes import name_takes
    from bcid.report.fleet_page import write_fleet_page
    from bcid.store.receipt import refuse_to_renew, renew_results

    workers = options.choose_workers(jobs, dask)
    # other processes even where it is one, as a log may end the process that works on it
    pool = make_pool(workers) if isinstance(workers, int) else workers
    models = tuple(dict.fromkeys(model or [USUAL_MODEL]))
    for name in models:
        fittable_row(name)
    sink, listed = Sink(format), find_logs(logs, labels)
    if listed.passed_over:
        sink.note(f"passed over, no recordings or further folders: {_list_names(listed.passed_over)}")
    config = options.read_config(
        pipeline, listed.logs, vehicle, out, None, allow_partial, force, ignore_health, sink.note, effects
    )
    # what all logs have in common is refused once, before any takes its time
    work = Pipeline(config, sink)
    work.refuse_untrainable(models)
    names = name_takes(listed.logs)
    labelled = label_logs(listed.logs, [names[log] for log in listed.logs], labels)
    compared = _place_everywhere(simulation, diagnose)
    sink.note(labelled.describe())
    refuse_to_renew(config.workspace, [FLEET_FILE, FLEET_PAGE], force)
    with sink.stage(f"fleet of {len(listed.logs)}") as progress:
        order = FleetOrder(config, models, diagnose, compared)
        document = run_fleet(order, listed.logs, labelled, work.vehicle.name, pool, progress)
    writers = {FLEET_FILE: document.write, FLEET_PAGE: lambda path: write_fleet_page(document, path)}
    renew_results(config.workspace, writers, force)
    sink.result(document.as_json(), lambda: _tables(document, config.workspace))
    for text in dict.fromkeys(f"{log.name}: {text}" for log in document.logs for text in log.notes):
        sink.note(text)
    sink.note(f"page: {config.workspace / FLEET_PAGE}")
    _raise_what_failed(document)


def _place_everywhere(simulation: str | None, diagnose: bool) -> str | None:
    """What logs are compared with, by a path that holds in every process; a module keeps its name.

    Raises:
        UsageError: nothing is compared, or there is no such file, folder or module.
    """
    from bcid.recording.cuts import without_cut

    if simulation is None:
        return None
    if not diagnose:
        raise UsageError("--simulation is compared with by diagnoses\n  next: leave it or --no-diagnose out")
    path = Path(simulation)
    if without_cut(path).exists():
        return str(path.absolute())
    if ":" not in simulation:
        raise UsageError(f"--simulation {simulation}: there is no such file or folder\n  next: check the path")
    return simulation


def _list_names(paths: Sequence[Path]) -> str:
    """The names of files and folders, the first of them if there are many."""
    more = len(paths) - SHOWN_NAMES
    return ", ".join(p.name + "/" * p.is_dir() for p in paths[:SHOWN_NAMES]) + (f" and {more} more" if more > 0 else "")


def _tables(document: FleetDocument, workspace: Path) -> RenderableType:
    """A line for each log, and below them what failed, with its cause and its next step."""
    from rich.console import Group
    from rich.markup import escape

    from bcid.cli.sink import plain_table
    from bcid.report.fleet_words import fleet_sentences

    columns = ["log", "", "lasts", *(f"NMSE of {name}" for name in document.models), "on", "found"]
    rows = [_cells(log, document.models) for log in document.logs]
    wrong = [
        escape(f"\n{log.name}: {problem.stage}: {problem.text}") for log in document.logs for problem in log.problems
    ] + [escape(f"\n{problem.stage}: {problem.text}") for problem in document.problems]
    caption = f"of each log's models on the next log; artifacts of each log: {workspace / FLEET_FILE}"
    said = [escape(f"\n{sentence}") for sentence in fleet_sentences(document)]
    return Group(plain_table(document.vehicle, columns, rows, caption), *said, *wrong)


def _cells(log: FleetLog, models: Sequence[str]) -> list[str]:
    """The line of a log: name, state, length, NMSE of each model, on which log, what the diagnosis found."""
    from bcid.report.formats import format_number

    nmse = {score.model: format_number(score.nmse, 2) for score in log.scores}
    found = "" if log.diagnosis is None else ", ".join(log.diagnosis.effects) or log.diagnosis.verdict
    lasts = "" if log.duration_s is None else f"{log.duration_s:.0f} s"
    state = "no-go" if log.go is False and log.state == "failed" else log.state
    on = log.scores[0].on if log.scores else ""
    return [log.name, state, lasts, *(nmse.get(name, "–") for name in models), on, found]


def _raise_what_failed(document: FleetDocument) -> None:
    """Raise `PartLost` where a stage of a log failed, with the logs' names."""
    failed, partly = ([log.name for log in document.logs if log.state == state] for state in ("failed", "partly"))
    told = [
        f"{len(names)} of {len(document.logs)} logs {what}: {', '.join(names)}"
        for names, what in ((failed, "failed"), (partly, "came through in part"))
        if names
    ] + [f"{problem.stage} failed" for problem in document.problems]
    if told:
        raise PartLost(f"{'; '.join(told)}\n  next: mend what is told of each; what is done will be reused")

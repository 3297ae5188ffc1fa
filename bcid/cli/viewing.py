"""`bcid view`: a take, or a diagnosis of it, as a file for viewers; results as tables for papers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bcid.cli import options
from bcid.cli.completion import complete_saved_models
from bcid.cli.options import Format
from bcid.errors import UsageError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bcid.cli.sink import Sink
    from bcid.view.content import ViewContent
    from bcid.view.write_view import WrittenView

VIEW_FOLDER = "view"


def view(
    subject: Annotated[
        Path,
        typer.Argument(
            metavar="TAKE|WORKSPACE", help="A recording, or a workspace with a diagnosis.", show_default=False
        ),
    ],
    vehicle: options.VehicleOption = None,
    take: Annotated[
        str | None,
        typer.Option(
            help="Which take of a diagnosis: its name, or its recorded file, whose stamps the view has then.",
            show_default="the first",
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            "--model", "-m", autocompletion=complete_saved_models,
            help="A saved model that is to predict a take: its name, or its folder.",
        ),
    ] = None,
    pipeline: options.LookupOption = None,
    effects: options.EffectsOption = None,
    tables: Annotated[
        Path | None, typer.Option(help="Write the results of a workspace as CSV and LaTeX to this folder, and no view.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="The MCAP file to write.", show_default="view/NAME.mcap")
    ] = None,
    commands: options.CommandsOption = None,
    allow_partial: options.AllowPartialOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:  # fmt: skip
    """Write a take, or a diagnosis of it, as an MCAP file with a layout for Foxglove; or results as tables."""
    from bcid.cli.sink import Sink
    from bcid.view.from_workspace import is_workspace

    sink, diagnosed = Sink(format), is_workspace(subject)
    _refuse_misfits(subject, diagnosed, take, model, tables, out, commands)
    if tables is not None:
        _write_tables(sink, subject, tables, force)
        return
    from bcid.files.outputs import refuse_to_overwrite
    from bcid.pipeline.named_models import find_model
    from bcid.view.from_take import view_of_take
    from bcid.view.from_workspace import view_of_workspace
    from bcid.view.write_view import OTHER_FILE, view_files, write_view

    folder = None if model is None else find_model(model, lambda: options.workspace_of(pipeline))
    with sink.stage("view"), options.own_effects(effects):
        if diagnosed:
            content = view_of_workspace(subject, take, vehicle, allow_partial)
        else:
            vehicle = vehicle or _find_vehicle(subject, pipeline, sink)
            content = view_of_take(subject, vehicle, folder, commands, allow_partial)
        home = subject if diagnosed else Path()
        path = out or home / VIEW_FOLDER / f"{content.recording.name}.mcap"
        refuse_to_overwrite(view_files(path), lambda there: force, OTHER_FILE)
        written = write_view(content, path, lambda there: force)
    topics = {name: {"type": kind, "messages": n} for name, (kind, n) in written.topics.items()}
    files = {"file": str(written.mcap), "layout": str(written.layout), "vehicle": str(written.vehicle)}
    sink.result({"schema": "bcid.view/1", **files, "topics": topics}, lambda: _topic_table(written, content))
    sink.note(f"layout for Foxglove: {written.layout}")
    sink.note(f"read back: bcid ingest --check {written.mcap} --vehicle {written.vehicle}")


def _refuse_misfits(
    subject: Path, diagnosed: bool, take: str | None, model: str | None, tables: Path | None, out: Path | None,
    commands: Path | None,
) -> None:  # fmt: skip
    """Raise `UsageError` for options that do not go together, with what to do about it."""
    if diagnosed and (model is not None or commands is not None):
        raise UsageError("--model and --commands go with a recording\n  next: leave them out, or name a recording")
    if not diagnosed and (take is not None or tables is not None):
        raise UsageError(f"--take and --tables go with a workspace, which {subject} is not\n  next: name a workspace")
    if tables is not None and (out is not None or take is not None):
        raise UsageError("with --tables no view is written\n  next: leave --out and --take out")
    if out is not None and out.suffix != ".mcap":
        raise UsageError(f"--out names the file to write, and {out} does not end in .mcap\n  next: name NAME.mcap")


def _find_vehicle(recording: Path, pipeline: Path | None, sink: Sink) -> Path:
    """The vehicle file of the pipeline file that is named or lies in this folder, by which a recording is read.

    Raises:
        UsageError: there is no pipeline file.
    """
    if pipeline is None and not options.PIPELINE_FILE.exists():
        cause = f"{recording} is no workspace, and a recording needs --vehicle VEHICLE.toml or a pipeline file"
        raise UsageError(f"{cause}\n  next: `bcid init` writes both")
    return options.read_pipeline(pipeline, sink.note).vehicle


def _write_tables(sink: Sink, workspace: Path, folder: Path, force: bool) -> None:
    """Write the tables of a workspace, and say which."""
    from bcid.cli.sink import plain_table
    from bcid.view.write_tables import workspace_tables, write_tables

    tables = workspace_tables(workspace)
    files = write_tables(tables, folder, lambda there: force)
    rows = [[t.name, str(len(t.rows)), t.caption] for t in tables]
    data = {"schema": "bcid.tables/1", "files": [str(file) for file in files]}
    sink.result(data, lambda: plain_table(f"tables in {folder}", ["table", "rows", "of"], rows))


def _topic_table(written: WrittenView, content: ViewContent) -> RenderableType:
    """The topics of a view with their types and how many messages each has."""
    from bcid.cli.sink import plain_table

    rows = [[name, kind, str(n)] for name, (kind, n) in written.topics.items()]
    title = f"{written.mcap}: {content.recording.duration_s:.0f} s of {content.recording.name}"
    return plain_table(title, ["topic", "type", "messages"], rows)

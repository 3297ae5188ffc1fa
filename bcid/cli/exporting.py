"""`bcid export`: a saved model in languages, frameworks and formats of others, each checked against the model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bcid.cli import options
from bcid.cli.completion import complete_export_formats, complete_saved_models
from bcid.cli.options import Format
from bcid.errors import UsageError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bcid.documents.export import ExportDocument

ALL = "all"
DEFAULT_FOLDER = Path("export")


def export(
    model: Annotated[
        str,
        typer.Argument(
            help="The name of a saved model, or its folder.", show_default=False, autocompletion=complete_saved_models
        ),
    ],
    format: Annotated[  # noqa: A002
        list[str] | None,
        typer.Option(
            help="c, python, casadi, acados, ros2, fmi, onnx, parameters or all; repeat for several.",
            show_default=ALL,
            autocompletion=complete_export_formats,
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The folder to write to.")] = DEFAULT_FOLDER,
    name: Annotated[
        str | None, typer.Option(help="What files and functions are called.", show_default="the model's name")
    ] = None,
    view: Annotated[
        str, typer.Option("--as", help="recording: poses as they were recorded. vehicle: the car itself.")
    ] = "recording",
    time: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Second of the recording at which effects of its time stand still.",
            show_default="they go on",
        ),
    ] = None,
    pipeline: options.WorkspaceOption = None,
    effects: options.EffectsOption = None,
    force: options.ForceOption = False,
    output: Annotated[Format, typer.Option(help="Format of the results on stdout.")] = Format.human,
) -> None:
    """Write a saved model as code for controllers and simulations; each file is run against the model before."""
    from bcid.cli.sink import Sink
    from bcid.evaluation.validity import load_validity
    from bcid.export.exported import export_model
    from bcid.export.formats import FORMATS
    from bcid.export.write import write_export
    from bcid.libraries import install_command
    from bcid.models.saving import load_model, model_digest
    from bcid.pipeline.named_models import find_model

    for one in format or []:
        if one not in (*FORMATS, ALL):
            raise UsageError(f"there is no format {one!r}\n  next: choose of {', '.join(FORMATS)}, {ALL}")
    if view not in ("recording", "vehicle"):
        raise UsageError(f"a model is exported as recording or as vehicle, not as {view!r}\n  next: choose one of them")
    sink = Sink(output)
    folder = find_model(model, lambda: options.workspace_of(pipeline))
    with sink.stage("export") as progress, options.own_effects(effects):
        exported = export_model(
            load_model(folder), model_digest(folder), load_validity(folder), name, view == "vehicle", time
        )
        suited = [one for one in FORMATS if FORMATS[one].suits(exported)]
        everything = not format or ALL in format
        formats = [one for one in suited if not FORMATS[one].missing_library()] if everything else format or []
        document = write_export(exported, formats, out, lambda path: force, progress)
    sink.result(document.as_json(), lambda: _table(document))
    sink.note(f"written to: {out}")
    for made in document.formats:
        if made.not_checked and FORMATS[made.format].check:
            sink.note(f"warning: {made.format} was not run: {made.not_checked}")
    for one in suited if everything else ():
        if library := FORMATS[one].missing_library():
            sink.note(f"{one} was left out: {library} is not installed\n  next: {install_command(library)}")
    document.raise_if_refused()


def _table(document: ExportDocument) -> RenderableType:
    """The formats with their files, and how far each is off the model."""
    from bcid.cli.sink import plain_table

    rows = [
        [made.format, ", ".join(made.files), "not run" if made.error is None else f"{made.error:.1e}"]
        for made in document.formats
    ]
    steps, n = len(document.vectors.commands), len(document.states)
    caption = f"error: the largest of a twist (m/s, rad/s) over {steps} steps beside the model itself"
    title = f"{document.name}: {n} states, 2 commands, a step of {document.period_s:g} s"
    return plain_table(title, ["format", "files", "error"], rows, caption)

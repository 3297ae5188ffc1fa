"""`bcid adapt`: constants of a car estimated while it drives, over a recording, and the filter as C."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bcid.adaptation.settings import FORGET_S
from bcid.cli import options
from bcid.cli.completion import complete_saved_models
from bcid.cli.options import Format

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bcid.documents.adapt import AdaptDocument

DEFAULT_FOLDER = Path("adapted")
NAME = "car"
NOT_SHOWN = 0.95
"""Share of a quantity's standard deviation at first from which on a drive says nothing of it."""
C_FILES = ("_adapt.h", "_adapt.c", "_adapt_test.c")
"""What follows the name in those of the files in C."""


def adapt(
    model: Annotated[
        str,
        typer.Argument(
            help="The name of a saved newton-euler model, of `diagnosis`, or its folder.", show_default=False,
            autocompletion=complete_saved_models,
        ),
    ],
    recording: Annotated[Path, typer.Argument(help="The recording that it follows.", show_default=False)],
    quantity: Annotated[
        list[str] | None,
        typer.Option(
            "--quantity", "-q", show_default="mass",
            help="What is estimated; repeat for several: mass, grip, motor, drag, a constant of the car such as C_f, "
            "an effect such as steering_offset, or one parameter of it, EFFECT.SYMBOL.",
        ),
    ] = None,
    forget: Annotated[
        float, typer.Option(min=1.0, help="Time (s) after which what a drive no longer shows is forgotten.")
    ] = FORGET_S,
    name: Annotated[str, typer.Option(help="What the functions in C are called.")] = NAME,
    vehicle: options.VehicleOption = None,
    commands: options.CommandsOption = None,
    out: Annotated[Path, typer.Option("--out", help="The folder to write to.")] = DEFAULT_FOLDER,
    pipeline: options.PipelineOption = None,
    effects: options.EffectsOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:  # fmt: skip
    """Estimate mass, grip or other constants of a car while it drives, and write the filter that does so in C."""
    from bcid.adaptation.recovery import errors_over_time
    from bcid.adaptation.write import DOCUMENT, TABLE, write_adaptation
    from bcid.cli.sink import Sink
    from bcid.export.names import check_name
    from bcid.files.outputs import refuse_to_overwrite, staged_outputs
    from bcid.models.saving import model_digest
    from bcid.pipeline.adapted_take import adapt_over_take
    from bcid.pipeline.named_models import find_model
    from bcid.pipeline.run import Pipeline

    sink, name = Sink(format), check_name(name)
    refuse_to_overwrite(
        [out / file for file in (TABLE, DOCUMENT, *(name + end for end in C_FILES))], lambda path: force
    )
    # what is ingested and estimated lies in the pipeline file's workspace, or without one beside the results
    home = out if vehicle and not pipeline else None
    config = options.read_config(
        pipeline, [recording], vehicle, home, commands, allow_partial, force, ignore_health, sink.note, effects
    )
    folder = find_model(model, lambda: options.workspace_of(pipeline))
    work = Pipeline(config, sink)
    work.refuse_unusable([recording])
    work.estimate(recording)
    with sink.stage("adapt") as progress, work.runner.own_effects_of(folder):
        progress(0.1, "the filter")
        adapted, car, estimate, released = adapt_over_take(work, recording, folder, quantity or ["mass"], forget)
        progress(0.6, "its predictions")
        errors = errors_over_time(adapted, car, estimate)
        with staged_outputs(out, lambda path: force) as staged:
            document = write_adaptation(adapted, errors, estimate, name, model_digest(folder), staged, released)
    sink.result(document.as_json(), lambda: _tables(document))
    for text in _doubts(document):
        sink.note(text)
    sink.note(f"written to: {out}")
    work.raise_if_parts_lost()


def _doubts(document: AdaptDocument) -> list[str]:
    """What a person should know of the result beside its figures."""
    texts, errors = list[str](), document.errors
    if document.released:
        texts.append(
            f"the drives of the model did not reach {', '.join(document.released)}: the adapted car has m g there"
        )
    lost = errors.frozen is not None and errors.adapted is None and errors.predictions
    if lost or (errors.loss_ci95 is not None and errors.loss_ci95[0] > 0.0):
        texts.append(
            "warning: following these made predictions worse: something else has changed, which `bcid diagnose` names, "
            "or nothing has, and following costs as much"
        )
    return texts


def _tables(document: AdaptDocument) -> RenderableType:
    """The quantities after the recording, and what following them was worth."""
    from bcid.cli.sink import plain_table
    from bcid.report.formats import format_with_error

    rows = []
    for q in document.quantities:
        what = f"times {', '.join(q.constants)}" if q.is_factor else q.unit
        end = " (at a bound)" if q.last in (q.low, q.high) else ""
        end += " (this drive does not show it)" if q.last_sd > NOT_SHOWN * q.first_sd else ""
        rows.append([q.name, f"{q.first:g}", format_with_error(q.last, q.last_sd) + end, what])
    errors = document.errors
    frozen, adapted = ("lost" if x is None else f"{x:.3f} m off" for x in (errors.frozen, errors.adapted))
    caption = (
        f"position after {errors.horizon_s:g} s, {errors.predictions} predictions, root mean square: {adapted} "
        f"as it was known at each moment, {frozen} as the model was"
        if errors.predictions else f"no stretch lasts {errors.horizon_s:g} s, so that nothing is predicted"
    )  # fmt: skip
    columns = ["quantity", "at first", "at the end", "acts on"]
    return plain_table(f"{document.model} on {document.recording}", columns, rows, caption)

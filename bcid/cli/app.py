"""`bcid`: the commands.  Heavy imports happen inside the command that needs them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from bcid import __version__
from bcid.cli import diagnosing, listing, options
from bcid.cli.adapting import adapt
from bcid.cli.benching import bench
from bcid.cli.comparing import compare
from bcid.cli.examples import examples_text
from bcid.cli.exits import run_and_explain
from bcid.cli.exporting import export
from bcid.cli.fitting import fit
from bcid.cli.fleets import fleet
from bcid.cli.options import Format
from bcid.cli.pooling import pool
from bcid.cli.predicting import predict
from bcid.cli.proving import prove
from bcid.cli.reporting import report, run
from bcid.cli.simulating import simulate
from bcid.cli.starting import init
from bcid.cli.viewing import view
from bcid.errors import Problems, UsageError

app = typer.Typer(
    name="bcid",
    help="From motion-capture logs of small ground vehicles to fitted planar models and a comparison.",
    no_args_is_help=True,
    epilog="bcid COMMAND --help ends with examples.  Tab completion: bcid --install-completion, then a new shell.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain text: what draws boxes takes longer to import than all the rest
    context_settings={"max_content_width": 140},
)


def _print_version(requested: bool) -> None:
    """Print the version and end, if it is `requested`."""
    if requested:
        typer.echo(f"bcid {__version__}")
        raise typer.Exit


@app.callback()
def accept_global_options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Accept the options that stand before a command; there is only `--version`."""
    from bcid.pipeline.making_date import making_date

    making_date()  # one that is stated and is none is refused before any work: libraries take it for a number


def ingest(
    recordings: options.RecordingsArgument = None,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    commands: options.CommandsOption = None,
    check: Annotated[
        bool, typer.Option("--check", help="Only report the health of each recording: go, or no-go and why.")
    ] = False,
    table: Annotated[
        Path | None,
        typer.Option(
            "--table", metavar="FILE.parquet|FILE.csv|FOLDER",
            help="Write what was read as tables as well: poses to this file, commands and channels beside it; or into "
            "a folder, a part for each recording.",
        ),
    ] = None,
    allow_partial: options.AllowPartialOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:  # fmt: skip
    """Read recordings, check and mend them, and report what is irregular: gaps, jumps, wrong units, clocks."""
    from bcid.cli import show
    from bcid.cli.checking import check_recordings
    from bcid.cli.sink import Sink
    from bcid.pipeline.partitioned_tables import write_partitioned_tables
    from bcid.pipeline.run import Pipeline
    from bcid.pipeline.tidy_tables import check_table_name, names_folder, write_tidy_tables
    from bcid.recording.saving import RecordingSummary, load_recording

    if check and table:
        raise UsageError("--check writes nothing\n  next: leave --check or --table out")
    if table:
        check_table_name(table)
    if check:
        # nothing is written, so that no folder is asked for
        out = Path() if recordings else None
    sink = Sink(format)
    config = options.read_config(pipeline, recordings, vehicle, out, commands, allow_partial, note=sink.note)
    if check:
        check_recordings(config, sink)
        return
    work, taken, problems = Pipeline(config, sink), list[dict[str, Any]](), Problems()
    read: dict[str, Path] = {}
    for path in work.config.recordings():
        # after a refusal the other recordings are read all the same
        with problems.gather_refusals():
            made = work.ingest(path)
            summary = RecordingSummary.read(made.folder / "recording.json")
            taken.append(summary.as_json() | {"name": work.names[path], "folder": str(made.folder)})
            read[work.names[path]] = made.folder
    if taken:
        sink.result({"schema": "bcid.ingest/1", "recordings": taken}, lambda: show.recording_tables(taken))
    problems.raise_if_any(work.config.recordings()[0])
    if table:
        if names_folder(table):
            written = write_partitioned_tables(table, read, lambda there: force)
        else:
            takes = {name: load_recording(folder) for name, folder in read.items()}
            written = write_tidy_tables(table, takes, lambda there: force)
        sink.note(f"written to: {', '.join(map(str, written))}")
    work.raise_if_parts_lost()


def estimate(
    recordings: options.RecordingsArgument = None,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    commands: options.CommandsOption = None,
    allow_partial: options.AllowPartialOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Estimate velocities and slip angles from recorded poses with an extended Kalman filter and smoother."""
    from bcid.cli import show
    from bcid.cli.sink import Sink
    from bcid.estimate.consistency import TruthCheck
    from bcid.estimate.saving import EstimateSummary
    from bcid.pipeline.run import Pipeline

    sink = Sink(format)
    config = options.read_config(pipeline, recordings, vehicle, out, commands, allow_partial, note=sink.note)
    work = Pipeline(config, sink)
    estimates = []
    for path in work.config.recordings():
        made, check = work.estimate(path), work.check(path)
        named = {"name": work.names[path]}
        summary = EstimateSummary.read(made.folder / "estimate.json").model_copy(update=named)
        checked = TruthCheck.read(check.folder / "check.json").model_copy(update=named) if check else None
        estimates.append(show.EstimatedTake(summary, made.folder, checked))
    data = {"schema": "bcid.estimate/1", "estimates": [e.as_json() for e in estimates]}
    sink.result(data, lambda: show.estimate_tables(estimates))
    work.raise_if_parts_lost()


# in the order in which a newcomer needs them, each with its line in the list
COMMANDS: dict[str, tuple[Callable[..., None], str]] = {
    "init": (init, "Write a commented vehicle file and pipeline file."),
    "ingest": (ingest, "Read recordings, check and mend them."),
    "estimate": (estimate, "Estimate velocities and slip angles from poses."),
    "fit": (fit, "Fit models to the training recordings."),
    "report": (report, "Compare the fitted models in closed loop."),
    "run": (run, "Do everything in the pipeline file."),
    "diagnose": (diagnosing.diagnose, "Name the physics that the model lacks."),
    "compare": (compare, "Say whether two runs show the same car."),
    "pool": (pool, "Fit one car to many recordings."),
    "fleet": (fleet, "Do everything with each of many logs."),
    "plan": (diagnosing.write_plan, "Plan a drive that shows given effects."),
    "simulate": (simulate, "Drive the simulated car, or a saved model."),
    "predict": (predict, "Predict pose and twist with a saved model."),
    "adapt": (adapt, "Follow mass, grip or other constants over a drive."),
    "export": (export, "Write a saved model as code."),
    "view": (view, "Write a take or a diagnosis for Foxglove."),
    "models": (listing.list_models, "List the models."),
    "effects": (listing.list_effects, "List the effects that a diagnosis can name."),
    "bench": (bench, "Measure speed and accuracy beside other libraries."),
    "prove": (prove, "Conceal effects, and count how many are found."),
}
for name, (command, line) in COMMANDS.items():
    app.command(name, epilog=examples_text(name), short_help=line)(command)


def main() -> None:
    """Run the command line; an error is printed on stderr as one message, and its exit code ends the process."""
    sys.exit(run_and_explain(lambda: app(standalone_mode=False)))

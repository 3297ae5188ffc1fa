"""`bcid`: the commands.  Heavy imports happen inside the command that needs them."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from bcid import __version__
from bcid.cli import diagnosing, listing, options
from bcid.cli.benching import bench
from bcid.cli.exits import run_and_explain
from bcid.cli.exporting import export
from bcid.cli.options import Format
from bcid.cli.proving import prove
from bcid.cli.simulating import simulate
from bcid.cli.starting import init
from bcid.errors import Problems, UsageError

REPORT_FILES = ("index.html", "report.json", "model_card.json")

app = typer.Typer(
    name="bcid",
    help="From motion-capture logs of small ground vehicles to fitted planar models and a comparison.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
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


def run(
    pipeline: options.PipelineOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Do everything in the pipeline file: ingest, estimate, fit and compare all models, and diagnose."""
    report(
        pipeline=pipeline, allow_partial=allow_partial, ignore_health=ignore_health, force=force, format=format
    )  # fmt: skip


def report(
    model: Annotated[
        list[Path] | None,
        typer.Option("--model", "-m", help="A folder with a saved model to compare as well; repeat for several."),
    ] = None,
    pipeline: options.PipelineOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Compare the fitted models in closed loop on the validation recording: a page, a JSON, a table."""
    from bcid.cli import show
    from bcid.cli.sink import Sink
    from bcid.documents.report import ReportDocument
    from bcid.pipeline.run import Pipeline

    sink = Sink(format)
    config = options.read_config(
        pipeline, allow_partial=allow_partial, force=force, ignore_health=ignore_health
    )  # fmt: skip
    work = Pipeline(config, sink)
    work.refuse_to_publish_over(*REPORT_FILES, to="report")
    if work.config.diagnose:
        work.refuse_to_publish_over(*diagnosing.DIAGNOSIS_FILES, to="diagnosis")
    artifact = work.report(model or [])
    page = work.publish(artifact, *REPORT_FILES, to="report")
    document = ReportDocument.read(artifact.folder / "report.json")
    sink.result(document.as_json(), lambda: show.comparison_table(document))
    if document.diagnosis:
        sink.note(f"diagnosis: {document.diagnosis.sentence}")
        sink.note(f"diagnosis page: {diagnosing.publish_diagnosis(work, work.diagnose(), 'diagnosis')}")
    sink.note(f"report: {page}")
    work.raise_if_parts_lost()


def ingest(
    recordings: options.RecordingsArgument = None,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    commands: options.CommandsOption = None,
    check: Annotated[
        bool, typer.Option("--check", help="Only report the health of each recording: go, or no-go and why.")
    ] = False,
    allow_partial: options.AllowPartialOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Read recordings, check and mend them, and report what is irregular: gaps, jumps, wrong units, clocks."""
    from bcid.cli import show
    from bcid.cli.checking import check_recordings
    from bcid.cli.sink import Sink
    from bcid.pipeline.run import Pipeline
    from bcid.recording.saving import RecordingSummary

    if check:
        # nothing is written, so that no folder is asked for
        out = Path() if recordings else None
    config, sink = options.read_config(pipeline, recordings, vehicle, out, commands, allow_partial), Sink(format)
    if check:
        check_recordings(config, sink)
        return
    work, taken, problems = Pipeline(config, sink), list[dict[str, Any]](), Problems()
    for path in work.config.recordings():
        # after a refusal the other recordings are read all the same
        with problems.gather_refusals():
            made = work.ingest(path)
            summary = RecordingSummary.read(made.folder / "recording.json")
            taken.append(summary.as_json() | {"name": work.names[path], "folder": str(made.folder)})
    if taken:
        sink.result({"schema": "bcid.ingest/1", "recordings": taken}, lambda: show.recording_tables(taken))
    problems.raise_if_any(work.config.recordings()[0])
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
    work = Pipeline(options.read_config(pipeline, recordings, vehicle, out, commands, allow_partial), sink)
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


def fit(
    recordings: options.RecordingsArgument = None,
    model: Annotated[
        list[str] | None,
        typer.Option("--model", "-m", help="A model to fit; repeat for several. Default: those in the pipeline file."),
    ] = None,
    loss: Annotated[
        str | None,
        typer.Option(help="one-step (the paper's), rollout, or poses (newton-euler). Default: the pipeline file's."),
    ] = None,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    commands: options.CommandsOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Fit models to the training recordings and print their equations."""
    from bcid.cli.sink import Sink
    from bcid.models.settings import LOSSES
    from bcid.models.table import fittable_row
    from bcid.pipeline.run import Pipeline

    if loss is not None and loss not in LOSSES:
        raise UsageError(f"there is no loss {loss!r}\n  next: choose {' or '.join(LOSSES)}")
    for name in model or []:
        # a model without losses of its own is fitted on its base model's
        losses = fittable_row(name).losses or LOSSES
        if loss is not None and loss not in losses:
            raise UsageError(f"{name} is not fitted on {loss}\n  next: choose {' or '.join(losses)}")
    config = options.read_config(
        pipeline, recordings, vehicle, out, commands, allow_partial, ignore_health=ignore_health
    )  # fmt: skip
    sink = Sink(format)
    work = Pipeline(config if loss is None else config.with_loss(loss), sink)
    work.refuse_untrainable(model or work.config.models)
    fitted: list[dict[str, Any]] = []
    for name in model or work.config.models:
        folder = work.fit(name).folder
        text = (folder / "description.txt").read_text(encoding="utf-8")
        fitted.append({"model": name, "folder": str(folder), "description": text})

    def human() -> str:
        return "\n".join(f"{f['model']}\n{f['description']}written to {f['folder']}\n" for f in fitted).rstrip()

    sink.result({"schema": "bcid.fit/1", "models": fitted}, human)
    work.raise_if_parts_lost()


# in the order in which a newcomer needs them
COMMANDS: dict[str, Callable[..., None]] = {
    "init": init, "ingest": ingest, "estimate": estimate, "fit": fit, "report": report, "run": run,
    "diagnose": diagnosing.diagnose, "plan": diagnosing.write_plan, "simulate": simulate, "export": export,
    "models": listing.list_models, "effects": listing.list_effects, "bench": bench, "prove": prove,
}  # fmt: skip
for name, command in COMMANDS.items():
    app.command(name)(command)


def main() -> None:
    """Run the command line; an error is printed on stderr as one message, and its exit code ends the process."""
    sys.exit(run_and_explain(lambda: app(standalone_mode=False)))

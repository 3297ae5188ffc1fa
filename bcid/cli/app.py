"""`bcid`: the commands.  Heavy imports happen inside the command that needs them."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from bcid import __version__
from bcid.cli import diagnosing, options
from bcid.cli.benching import bench
from bcid.cli.checking import check_recordings
from bcid.cli.limits import LIMITS
from bcid.cli.sink import Format, Sink, plain_table
from bcid.errors import BcidError, DiskFull, Problems, UsageError, is_disk_full
from bcid.models.settings import LOSSES
from bcid.models.table import MODELS, fittable_row
from bcid.pipeline.run import Pipeline

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
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Do everything in the pipeline file: ingest, estimate, fit and compare all models, and diagnose."""
    report(pipeline=pipeline, allow_partial=allow_partial, format=format)


def report(
    model: Annotated[
        list[Path] | None,
        typer.Option("--model", "-m", help="A folder with a saved model to compare as well; repeat for several."),
    ] = None,
    pipeline: options.PipelineOption = None,
    allow_partial: options.AllowPartialOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Compare the fitted models in closed loop on the validation recording: a page, a JSON, a table."""
    from bcid.cli import show
    from bcid.documents.report import ReportDocument

    sink = Sink(format)
    work = Pipeline(options.read_config(pipeline, allow_partial=allow_partial), sink)
    artifact = work.report(model or [])
    page = work.publish(artifact, "index.html", "report.json", to="report")
    document = ReportDocument.read(artifact.folder / "report.json")
    sink.result(document.as_json(), lambda: show.comparison_table(document))
    if document.diagnosis:
        sink.note(f"diagnosis: {document.diagnosis.sentence}")
        sink.note(f"diagnosis page: {work.publish(work.diagnose(), *diagnosing.DIAGNOSIS_FILES, to='diagnosis')}")
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
            taken.append(made.json("recording.json") | {"folder": str(made.folder)})
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
    from bcid.estimate.consistency import TruthCheck
    from bcid.estimate.saving import EstimateSummary

    sink = Sink(format)
    work = Pipeline(options.read_config(pipeline, recordings, vehicle, out, commands, allow_partial), sink)
    estimates = []
    for path in work.config.recordings():
        made, check = work.estimate(path), work.check(path)
        summary = EstimateSummary.read(made.folder / "estimate.json")
        checked = TruthCheck.read(check.folder / "check.json") if check else None
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
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Fit models to the training recordings and print their equations."""
    if loss is not None and loss not in LOSSES:
        raise UsageError(f"there is no loss {loss!r}\n  next: choose {' or '.join(LOSSES)}")
    for name in model or []:
        # a model without losses of its own is fitted on its base model's
        losses = fittable_row(name).losses or LOSSES
        if loss is not None and loss not in losses:
            raise UsageError(f"{name} is not fitted on {loss}\n  next: choose {' or '.join(losses)}")
    config = options.read_config(pipeline, recordings, vehicle, out, commands, allow_partial)
    sink = Sink(format)
    work = Pipeline(config if loss is None else config.with_loss(loss), sink)
    fitted: list[dict[str, Any]] = []
    for name in model or work.config.models:
        folder = work.fit(name).folder
        text = (folder / "description.txt").read_text(encoding="utf-8")
        fitted.append({"model": name, "folder": str(folder), "description": text})

    def human() -> str:
        return "\n".join(f"{f['model']}\n{f['description']}written to {f['folder']}\n" for f in fitted).rstrip()

    sink.result({"schema": "bcid.fit/1", "models": fitted}, human)
    work.raise_if_parts_lost()


def list_models(format: options.FormatOption = Format.human) -> None:  # noqa: A002
    """List the models, with what each is and which command makes it."""
    rows: list[dict[str, Any]] = [
        {
            "model": name, "summary": row.summary, "base": row.base, "defaults": dict(row.defaults),
            "made_by": row.made_by or "bcid fit",
        }
        for name, row in MODELS.items()
    ]  # fmt: skip
    shown = [[row[key] for key in ("model", "summary", "made_by")] for row in rows]
    Sink(format).result(
        {"schema": "bcid.models/1", "models": rows},
        lambda: plain_table("models", ["name", "what it is", "made by"], shown),
    )


def list_effects(
    name: Annotated[str | None, typer.Argument(help="The id of one effect to look up. Default: list all.")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Write the page docs/effects.md to stdout.")] = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """List the effects (terms of physics beyond the base model) that a diagnosis can name, or look up one of them."""
    from bcid.effects.listing import describe_effect, effect_json, effects_page
    from bcid.effects.table import EFFECTS, find_effect

    chosen = [find_effect(name)] if name else list(EFFECTS.values())

    def human() -> Any:
        if markdown:
            return effects_page(chosen)
        if name:
            return describe_effect(chosen[0])
        return plain_table("effects", ["id", "equation", "channel"], [[e.id, e.equation, e.channel] for e in chosen])

    Sink(format).result({"schema": "bcid.effects/1", "effects": [effect_json(e) for e in chosen]}, human)


def simulate(
    name: Annotated[str, typer.Argument(help="The take's name.")] = "simulated",
    out: Annotated[Path, typer.Option("--out", help="The folder to write to.")] = Path(),
    duration: Annotated[
        float | None,
        typer.Option(
            min=LIMITS.min_drive_s,
            max=LIMITS.max_drive_s,
            help="Length in seconds.",
            show_default="300, or as --commands",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed of driver, floor and noise.")] = 1,
    recorder: Annotated[str, typer.Option(help="Format of the recording: motive or mcap.")] = "motive",
    rate: Annotated[
        float, typer.Option(min=LIMITS.min_rate_hz, max=LIMITS.max_rate_hz, help="Poses per second.")
    ] = 60.0,
    ideal: Annotated[bool, typer.Option("--ideal", help="Drive the paper's car without a real car's extras.")] = False,
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="A constant of car or sensor as NAME=VALUE (most ids of `bcid effects`); repeat for several."
        ),
    ] = None,
    sample_logs: Annotated[Path | None, typer.Option(help="Write all sample logs into this folder instead.")] = None,
    model: Annotated[
        Path | None, typer.Option("--model", "-m", help="A folder with a saved model to drive instead of the car.")
    ] = None,
    commands: Annotated[Path | None, typer.Option("--commands", help="The commands file that --model drives.")] = None,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Drive the simulated car, or a saved model, and write logs as a lab would; for the car its true motion, too."""
    from bcid.simulation.car import configure_simulation
    from bcid.simulation.samples import SampleTake, write_sample_logs, write_sample_take

    sink = Sink(format)
    if (model is None) != (commands is None):
        raise UsageError("--model and --commands go together\n  next: name the model's folder and a commands file")
    if model is not None and (ideal or sample_logs is not None):
        raise UsageError("a saved model is driven as it is\n  next: leave --ideal and --sample-logs out")
    if Path(name).name != name:
        raise UsageError(f"{name!r} is no plain name\n  next: name the folder with --out")
    if recorder not in ("motive", "mcap"):
        raise UsageError(f"there is no recorder {recorder!r}\n  next: choose motive or mcap")
    plant, sensor = configure_simulation(ideal, change or [], rate)
    with sink.stage("simulate") as progress:
        if sample_logs is not None:
            paths = write_sample_logs(sample_logs, seed, lambda text: progress(0.0, text))
        elif model is not None and commands is not None:
            from bcid.cli.driving import check_only_noise_is_set, write_model_drive

            check_only_noise_is_set(change or [])
            take = SampleTake(name, recorder, duration or 0.0)
            paths, warnings = write_model_drive(out, take, model, commands, sensor, seed)
            for text in warnings:
                sink.note(f"warning: {text}")
        else:
            paths = [write_sample_take(out, SampleTake(name, recorder, duration or 300.0), plant, sensor, seed)]
    sink.result(
        {"schema": "bcid.simulate/1", "recordings": [str(p) for p in paths]}, lambda: "\n".join(map(str, paths))
    )


def init(
    folder: Annotated[Path, typer.Argument(help="The folder to write the two files to.")] = Path(),
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Write a commented vehicle file and pipeline file to start from."""
    templates = Path(__file__).parent / "templates"
    targets = [folder / source.name for source in sorted(templates.glob("*.toml"))]
    there = [str(t) for t in targets if t.exists()]
    if there:
        raise UsageError(f"{', '.join(there)} exists already\n  next: name another folder, or move it away")
    folder.mkdir(parents=True, exist_ok=True)
    for target in targets:
        target.write_bytes((templates / target.name).read_bytes())
    Sink(format).result(
        {"schema": "bcid.init/1", "files": [str(t) for t in targets]},
        lambda: "\n".join([*map(str, targets), f"next: edit both, then bcid run -p {folder / 'pipeline.toml'}"]),
    )


# in the order in which a newcomer needs them
COMMANDS: dict[str, Callable[..., None]] = {
    "init": init, "ingest": ingest, "estimate": estimate, "fit": fit, "report": report, "run": run,
    "diagnose": diagnosing.diagnose, "plan": diagnosing.write_plan, "simulate": simulate, "models": list_models,
    "effects": list_effects, "bench": bench, "prove": diagnosing.prove,
}  # fmt: skip
for name, command in COMMANDS.items():
    app.command(name)(command)


def main() -> None:
    """Run the command line; an error is printed on stderr as one message, and its exit code ends the process."""
    try:
        # ends by SystemExit, with 2 after wrong words
        app()
        return
    except BcidError as error:
        text, exit_code = str(error), error.exit_code
    except OSError as error:
        if is_disk_full(error):
            text = str(DiskFull(error.filename or "output"))
        elif error.filename is None:
            raise
        else:
            text = f"{error.filename}: {error.strerror}\n  next: check the path and its permissions"
        exit_code = DiskFull.exit_code
    except Exception as error:
        if os.environ.get("BCID_TRACEBACK"):
            raise
        text = f"internal error, {type(error).__name__}: {error}\n  next: run again with BCID_TRACEBACK=1 and report it"
        exit_code = 1
    Sink(Format.quiet).error(text)
    sys.exit(exit_code)

"""`bcid`: the commands.  Heavy imports happen inside the command that needs them."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from bcid import __version__
from bcid.cli import checking, diagnosing
from bcid.cli.benching import bench
from bcid.cli.options import (
    LONGEST_S,
    AllowPartialOption,
    CommandsOption,
    FormatOption,
    OutOption,
    PipelineOption,
    Recordings,
    VehicleOption,
    end,
    plan_of,
)
from bcid.cli.sink import Format, Sink, table
from bcid.errors import BcidError, DiskFull, Problems, UsageError, is_disk_full
from bcid.models.settings import LOSSES
from bcid.models.table import MODELS, row_to_fit
from bcid.pipeline.run import Pipeline

FIT = "bcid fit"

app = typer.Typer(
    name="bcid",
    help="From motion-capture logs of small ground vehicles to fitted planar models and a comparison.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bcid {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """From motion-capture logs of small ground vehicles to fitted planar models and a comparison."""


def run(
    pipeline: PipelineOption = None,
    allow_partial: AllowPartialOption = False,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Do everything: ingest, estimate, fit every model, evaluate, report, diagnose what the pipeline file names."""
    _report(pipeline, [], allow_partial, Sink(format))


def report(
    model: Annotated[
        list[Path] | None,
        typer.Option("--model", "-m", help="A folder with a saved model that joins the plan's; repeat for several."),
    ] = None,
    pipeline: PipelineOption = None,
    allow_partial: AllowPartialOption = False,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Compare the fitted models on the validation take: a page, a JSON, a table."""
    _report(pipeline, model or [], allow_partial, Sink(format))


def _report(pipeline: Path | None, models: list[Path], allow_partial: bool, sink: Sink) -> None:
    from bcid.cli import show

    work = Pipeline(plan_of(pipeline, allow_partial=allow_partial), sink)
    artifact = work.report(models)
    page = work.publish(artifact, "index.html", "report.json", to="report")
    found = artifact.json("report.json")
    sink.result(found, lambda: show.comparison(found))
    if work.plan.diagnose:
        sink.note(f"diagnosis: {found['diagnosis']['sentence']}")
        sink.note(f"diagnosis page: {work.publish(work.diagnose(), *diagnosing.PUBLISHED, to='diagnosis')}")
    sink.note(f"report: {page}")
    end(work)


def ingest(
    recordings: Recordings = None,
    pipeline: PipelineOption = None,
    vehicle: VehicleOption = None,
    out: OutOption = None,
    commands: CommandsOption = None,
    check: Annotated[
        bool, typer.Option("--check", help="A health report of each: go, or no-go and why. Nothing is written.")
    ] = False,
    allow_partial: AllowPartialOption = False,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Read recordings and say what is odd about them."""
    from bcid.cli import show

    sink = Sink(format)
    if check:
        checking.report(checking.checked(pipeline, recordings, vehicle, commands, allow_partial), sink)
        return
    work = Pipeline(plan_of(pipeline, recordings, vehicle, out, commands, allow_partial), sink)
    taken, problems = list[dict[str, Any]](), Problems()
    for path in work.takes():
        with problems.gathered():  # the others are read all the same
            made = work.ingest(path)
            taken.append(made.json("recording.json") | {"folder": str(made.folder)})
    if taken:
        sink.result({"schema": "bcid.ingest/1", "recordings": taken}, lambda: show.recordings(taken))
    problems.refuse(work.takes()[0])
    end(work)


def estimate(
    recordings: Recordings = None,
    pipeline: PipelineOption = None,
    vehicle: VehicleOption = None,
    out: OutOption = None,
    commands: CommandsOption = None,
    allow_partial: AllowPartialOption = False,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Estimate velocities and slip angles by the extended Kalman filter and its smoother."""
    from bcid.cli import show

    sink = Sink(format)
    work = Pipeline(plan_of(pipeline, recordings, vehicle, out, commands, allow_partial), sink)
    estimates = []
    for path in work.takes():
        made, check = work.estimate(path), work.check(path)
        more = {"folder": str(made.folder), "check": check.json("check.json") if check else None}
        estimates.append(made.json("estimate.json") | more)
    sink.result({"schema": "bcid.estimate/1", "estimates": estimates}, lambda: show.estimates(estimates))
    end(work)


def fit(
    recordings: Recordings = None,
    model: Annotated[
        list[str] | None, typer.Option("--model", "-m", help="A model's name; repeat for several. Default: the plan's.")
    ] = None,
    loss: Annotated[
        str | None, typer.Option(help="one-step (the paper's), rollout, or poses (newton-euler). Default: the plan's.")
    ] = None,
    pipeline: PipelineOption = None,
    vehicle: VehicleOption = None,
    out: OutOption = None,
    commands: CommandsOption = None,
    allow_partial: AllowPartialOption = False,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Fit models to the training takes and print their equations."""
    sink = Sink(format)
    for name in model or []:
        row_to_fit(name)
    plan = plan_of(pipeline, recordings, vehicle, out, commands, allow_partial)
    if loss is not None:
        if loss not in LOSSES:
            raise UsageError(f"there is no loss {loss!r}\n  next: choose {' or '.join(LOSSES)}")
        for name in model or []:  # one that has no loss of its own has its base model's
            losses = row_to_fit(name).losses or LOSSES
            if loss not in losses:
                raise UsageError(f"{name} is not fitted on {loss}\n  next: choose {' or '.join(losses)}")
        plan = plan.with_loss(loss)
    work = Pipeline(plan, sink)
    fitted: list[dict[str, Any]] = []
    for name in model or work.plan.models:
        artifact = work.fit(name)
        text = (artifact.folder / "description.txt").read_text(encoding="utf-8")
        fitted.append({"model": name, "folder": str(artifact.folder), "description": text})

    def human() -> str:
        return "\n".join(f"{f['model']}\n{f['description']}written to {f['folder']}\n" for f in fitted).rstrip()

    sink.result({"schema": "bcid.fit/1", "models": fitted}, human)
    end(work)


def models(format: FormatOption = Format.human) -> None:  # noqa: A002
    """List the models."""
    rows = [
        {"model": n, "summary": r.summary, "base": r.base, "defaults": dict(r.defaults), "made_by": r.made_by or FIT}
        for n, r in MODELS.items()
    ]
    shown = [[n, r.summary, r.made_by or FIT] for n, r in MODELS.items()]
    Sink(format).result(
        {"schema": "bcid.models/1", "models": rows},
        lambda: table("models", ["name", "what it is", "made by"], shown),
    )


def effects(
    name: Annotated[str | None, typer.Argument(help="One effect's id; all of them where none is named.")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="As the page docs/effects.md.")] = False,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """List the vocabulary of missing physics."""
    from bcid.effects.listing import as_json, as_markdown, details
    from bcid.effects.table import EFFECTS, effect_of

    chosen = [effect_of(name)] if name else list(EFFECTS.values())

    def human() -> Any:
        if markdown:
            return as_markdown(chosen)
        if name:
            return details(chosen[0])
        return table("effects", ["id", "equation", "channel"], [[e.id, e.equation, e.channel] for e in chosen])

    Sink(format).result({"schema": "bcid.effects/1", "effects": [as_json(e) for e in chosen]}, human)


def simulate(
    name: Annotated[str, typer.Argument(help="The take's name.")] = "simulated",
    out: Annotated[Path, typer.Option("--out", help="The folder to write to.")] = Path(),
    duration: Annotated[
        float | None,
        typer.Option(min=1.0, max=LONGEST_S, help="Length in seconds.", show_default="300, or the commands'"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of driver, floor and noise.")] = 1,
    recorder: Annotated[str, typer.Option(help="motive or mcap.")] = "motive",
    rate: Annotated[float, typer.Option(min=5.0, max=240.0, help="Poses per second.")] = 60.0,
    ideal: Annotated[bool, typer.Option("--ideal", help="The paper's car alone: none of a real car's extras.")] = False,
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="A constant of the car or the sensor, NAME=VALUE (most ids of bcid effects); repeat."
        ),
    ] = None,
    sample_logs: Annotated[Path | None, typer.Option(help="Make all of sample_logs/ in this folder instead.")] = None,
    model: Annotated[
        Path | None, typer.Option("--model", "-m", help="A folder with a saved model to drive instead of the car.")
    ] = None,
    commands: Annotated[
        Path | None, typer.Option("--commands", help="The commands file that the saved model drives.")
    ] = None,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Drive the simulated car, or a saved model, and write logs as a lab would; the car's with the truth apart."""
    from bcid.simulation.samples import Take, write_samples, write_take
    from bcid.simulation.settings import plant_and_sensor

    sink = Sink(format)
    if (model is None) != (commands is None):
        raise UsageError("--model and --commands go together\n  next: name the model's folder and a commands file")
    if model is not None and (ideal or sample_logs is not None):
        raise UsageError("a saved model is driven as it is\n  next: leave --ideal and --sample-logs out")
    with sink.stage("simulate") as progress:
        if sample_logs is not None:
            paths = write_samples(sample_logs, seed, lambda text: progress(0.0, text))
        else:
            if Path(name).name != name:
                raise UsageError(f"{name!r} is no plain name\n  next: name the folder with --out")
            if recorder not in ("motive", "mcap"):
                raise UsageError(f"there is no recorder {recorder!r}\n  next: choose motive or mcap")
            plant, sensor = plant_and_sensor(ideal, change or [], rate)
            if model is not None and commands is not None:
                from bcid.cli.driving import check_noise_alone, write_driven

                check_noise_alone(change or [])
                paths, warnings = write_driven(
                    out, Take(name, recorder, duration or 0.0), model, commands, sensor, seed
                )
                for text in warnings:
                    sink.note(f"warning: {text}")
            else:
                paths = [write_take(out, Take(name, recorder, duration or 300.0), plant, sensor, seed)]
    sink.result(
        {"schema": "bcid.simulate/1", "recordings": [str(p) for p in paths]}, lambda: "\n".join(map(str, paths))
    )


def init(
    folder: Annotated[Path, typer.Argument(help="Where to write the two files.")] = Path(),
    format: FormatOption = Format.human,  # noqa: A002
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


for command in (  # as a newcomer needs them
    init, ingest, estimate, fit, report, run, diagnosing.diagnose, diagnosing.plan, simulate, models, effects, bench,
    diagnosing.prove,
):  # fmt: skip
    app.command()(command)


def main() -> None:
    """Run the command line; every error is one message and one exit code."""
    try:
        app()  # ends by SystemExit; wrong words exit with 2
    except BcidError as error:
        Sink(Format.quiet).error(str(error))
        sys.exit(error.exit_code)
    except OSError as error:
        if is_disk_full(error):
            Sink(Format.quiet).error(str(DiskFull(error.filename or "output")))
            sys.exit(DiskFull.exit_code)
        if error.filename is None:
            raise
        Sink(Format.quiet).error(f"{error.filename}: {error.strerror}\n  next: check the path and its permissions")
        sys.exit(4)
    except Exception as error:
        if os.environ.get("BCID_TRACEBACK"):
            raise
        Sink(Format.quiet).error(
            f"internal error, {type(error).__name__}: {error}\n  next: run again with BCID_TRACEBACK=1 and report it"
        )
        sys.exit(1)

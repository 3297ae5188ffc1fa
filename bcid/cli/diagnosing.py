"""The commands about missing physics: diagnose, and plan, which says what to drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bcid.cli import options
from bcid.cli.options import Format
from bcid.errors import UsageError

if TYPE_CHECKING:
    from bcid.pipeline.run import Pipeline
    from bcid.store.artifact import Artifact

DEFAULT_PLAN = Path("plans/plan.commands.csv")
OTHER_PLAN = "name another file with --out"
PAGE_FILES = ("diagnosis.html", "model_card.json")
FOUND_FILES = ("diagnosis.json", "model", "next_manoeuvre.commands.csv")
DIAGNOSIS_FILES = (*PAGE_FILES, *FOUND_FILES)


def diagnose(
    recordings: options.RecordingsArgument = None,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    commands: options.CommandsOption = None,
    simulation: Annotated[
        str | None,
        typer.Option(
            help="What to compare with: the folder of a saved newton-euler model, a TOML file of its parameters, "
            "another simulator's recording of the same car, or module:function. Default: newton-euler, refitted on the "
            "recordings."
        ),
    ] = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Name the physics that recordings show and the model lacks, and prove it by predicting held-out blocks of them."""
    from bcid.cli import show
    from bcid.cli.sink import Sink
    from bcid.documents.full_diagnosis import FullDiagnosis
    from bcid.pipeline.run import Pipeline

    sink = Sink(format)
    config = options.read_config(pipeline, recordings, vehicle, out, commands, allow_partial, force, ignore_health)
    work = Pipeline(config, sink)
    home = "" if recordings else "diagnosis"
    work.refuse_to_publish_over(*DIAGNOSIS_FILES, to=home)
    artifact = work.diagnose(simulation)
    page = publish_diagnosis(work, artifact, home)
    document = FullDiagnosis.read(artifact.folder / "diagnosis.json")
    sink.result(document.as_json(), lambda: show.diagnosis_tables(document))
    sink.note(f"page: {page}\nmodel: {page.parent / 'model'} (bcid report --model, bcid simulate --model)")
    work.raise_if_parts_lost()


def publish_diagnosis(work: Pipeline, artifact: Artifact, home: str) -> Path:
    """Publish a diagnosis with its page in the folder `home` of the workspace; return the page's path."""
    page = work.diagnosis_page(artifact)
    work.publish(artifact, *FOUND_FILES, to=home)
    return work.publish(page, *PAGE_FILES, to=home)


def write_plan(
    vehicle: Annotated[Path, typer.Option("--vehicle", help="The vehicle file.")],
    effects: Annotated[
        list[str] | None, typer.Argument(help="Ids of the effects that are to show. Default: all.")
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", help="The commands file to write, or the folder for plan.commands.csv.")
    ] = DEFAULT_PLAN,
    arena: Annotated[tuple[float, float], typer.Option(help="Length and width of the arena in metres.")] = (12.0, 7.0),
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Plan a drive in which the given effects become detectable, and write its steering and throttle as a file."""
    from bcid.cli.sink import Sink, plain_table
    from bcid.effects.table import EFFECTS, find_effect
    from bcid.experiment.manoeuvres import Arena, write_commands
    from bcid.experiment.plan import largest_throttle, nominal_car, plan_drives
    from bcid.files.outputs import refuse_to_overwrite, write_output
    from bcid.likelihood.prepare import effect_constants
    from bcid.vehicle import read_vehicle

    asked = [find_effect(name).id for name in effects or EFFECTS]
    out = out / DEFAULT_PLAN.name if out.is_dir() else out
    refuse_to_overwrite([out], lambda path: force, OTHER_PLAN)
    car, sink = read_vehicle(vehicle), Sink(format)
    steering = {"T_s": car.steering.time_constant_s, "d": car.steering.max_rate_radps}
    unknown = tuple(symbol for symbol, value in steering.items() if value is None)
    with sink.stage("plan"):
        found = plan_drives(
            nominal_car(car), effect_constants(car), car.steering.max_angle_rad, asked,
            largest_throttle(car), Arena(*arena), unknown,
        )  # fmt: skip
    if not found.parts:
        raise UsageError(f"no manoeuvre fits {arena[0]:g} by {arena[1]:g} m\n  next: give the --arena that is free")
    write_output(out, lambda path: write_commands(path, found.command_s, found.command), lambda path: force, OTHER_PLAN)
    parts: list[dict[str, Any]] = [
        {
            "name": p.drive.name, "begin_s": p.begin_s, "seconds": p.drive.seconds,
            "start": [float(v) for v in p.drive.start],
        }
        for p in found.parts
    ]  # fmt: skip
    smallest = {
        e: None if sizes is None else {k: {"value": v, "unit": u} for k, (v, u) in sizes.items()}
        for e, sizes in found.detectable_sizes.items()
    }
    data = {
        "schema": "bcid.plan/1", "file": str(out), "minutes": found.minutes, "parts": parts, "smallest": smallest,
        "missing": found.missing,
    }  # fmt: skip
    columns = ["drive", "from", "lasts", "start x, y, yaw (m, m, rad)"]
    rows = [
        [p["name"], f"{p['begin_s']:.0f} s", f"{p['seconds']:.0f} s", ", ".join(f"{v:.2f}" for v in p["start"])]
        for p in parts
    ]
    missing = "; ".join(f"{e}: {why}" for e, why in found.missing.items())
    title, note = f"{found.minutes:.1f} minutes in {out}", f"not shown by any drive: {missing}" if missing else ""
    sink.result(data, lambda: plain_table(title, columns, rows, note))

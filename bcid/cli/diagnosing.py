"""The commands about missing physics: diagnose, and plan, which says what to drive."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bcid.cli import options
from bcid.cli.completion import complete_effects
from bcid.cli.options import Format
from bcid.cli.reporting import DIAGNOSIS_FILES, publish_diagnosis
from bcid.errors import UsageError

if TYPE_CHECKING:
    from bcid.documents.diagnosis import HorizonError

DEFAULT_PLAN = Path("plans/plan.commands.csv")
DEFAULT_ARENA = "12,7"
OTHER_PLAN = "name another file with --out"


def diagnose(
    recordings: options.RecordingsArgument = None,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    commands: options.CommandsOption = None,
    simulation: options.SimulationOption = None,
    effects: options.EffectsOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Name the physics that recordings show and the model lacks, and prove it by predicting held-out blocks of them."""
    from bcid.cli import show
    from bcid.cli.sink import Sink
    from bcid.documents.diagnosis import DiagnosisDocument
    from bcid.pipeline.named_models import DIAGNOSED, WITH_REMAINDER
    from bcid.pipeline.run import Pipeline

    sink = Sink(format)
    config = options.read_config(
        pipeline, recordings, vehicle, out, commands, allow_partial, force, ignore_health, sink.note, effects
    )
    work = Pipeline(config, sink)
    # beside a pipeline's own results those of named recordings would stand in the way
    home = "" if out else "diagnosis"
    work.refuse_to_publish_over(*DIAGNOSIS_FILES, to=home)
    artifact = work.diagnose(simulation)
    page = publish_diagnosis(work, artifact, home)
    document = DiagnosisDocument.read(artifact.folder / "diagnosis.json")
    sink.result(document.as_json(), lambda: show.diagnosis_tables(document))
    model = DIAGNOSED if not out else page.parent / "model"
    compares = "compares the car with what was found, a newton-euler-augmented, with others"
    sink.note(f"page: {page}\nnext: bcid report --model {model} {compares}")
    if (page.parent / WITH_REMAINDER).is_dir() and free_functions_predict_better(document.horizons):
        sink.note(f"{page.parent / WITH_REMAINDER} {describe_free_functions(document.horizons)}")
    work.raise_if_parts_lost()


def free_functions_predict_better(horizons: Sequence[HorizonError]) -> bool:
    """Whether free functions make a held-out error smaller than the names alone, by what two decimals show."""
    return any(h.nmse_remainder < 0.995 * h.nmse_after for h in horizons if h.nmse_remainder and h.nmse_after)


def describe_free_functions(horizons: Sequence[HorizonError]) -> str:
    """What the model with free functions is, and how its held-out errors compare with those of the names alone.

    >>> from bcid.documents.diagnosis import HorizonError
    >>> describe_free_functions([HorizonError(horizon_s=2.0, nmse_after=0.04, nmse_remainder=0.01)])[-50:]
    'predictions: held out, 0.25 times the error at 2 s'
    """
    ratios = {h.horizon_s: h.nmse_remainder / h.nmse_after for h in horizons if h.nmse_remainder and h.nmse_after}
    told = ", ".join(f"{ratio:.2f} times the error at {horizon:g} s" for horizon, ratio in ratios.items())
    return f"adds free functions of the car's state where this drive went, for predictions: held out, {told or 'lost'}"


def read_arena(text: str) -> tuple[float, float]:
    """Length and width (m) of an arena, of two numbers with a comma, an x or a blank between them.

    >>> read_arena("12,7"), read_arena("3.5 x 2")
    ((12.0, 7.0), (3.5, 2.0))

    Raises:
        UsageError: these are not two lengths above zero.
    """
    try:
        length_m, width_m = (float(word) for word in re.split(r"[\s,;x×]+", text.strip()))
    except ValueError:
        length_m = width_m = math.nan
    if not (0.0 < length_m < math.inf and 0.0 < width_m < math.inf):
        raise UsageError(f"--arena {text!r} is not a length and a width\n  next: write both in metres, such as 12,7")
    return length_m, width_m


def write_plan(
    vehicle: Annotated[Path, typer.Option("--vehicle", help="The vehicle file.")],
    effects: Annotated[
        list[str] | None,
        typer.Argument(help="Ids of the effects that are to show. Default: all.", autocompletion=complete_effects),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", help="The commands file to write, or the folder for plan.commands.csv.")
    ] = DEFAULT_PLAN,
    arena: Annotated[
        str, typer.Option(metavar="LENGTH,WIDTH", help="Length and width of the free floor in metres, such as 12,7.")
    ] = DEFAULT_ARENA,
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

    length_m, width_m = read_arena(arena)
    asked = [find_effect(name).id for name in effects or EFFECTS]
    out = out / DEFAULT_PLAN.name if out.is_dir() else out
    refuse_to_overwrite([out], lambda path: force, OTHER_PLAN)
    car, sink = read_vehicle(vehicle), Sink(format)
    steering = {"T_s": car.steering.time_constant_s, "d": car.steering.max_rate_radps}
    unknown = tuple(symbol for symbol, value in steering.items() if value is None)
    with sink.stage("plan"):
        found = plan_drives(
            nominal_car(car), effect_constants(car), car.steering.max_angle_rad, asked,
            largest_throttle(car), Arena(length_m, width_m), unknown,
        )  # fmt: skip
    if not found.parts:
        raise UsageError(f"no manoeuvre fits {length_m:g} by {width_m:g} m\n  next: give the --arena that is free")
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

"""`bcid simulate`: drives of the simulated car, or of a saved model, recorded as a lab would record them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bcid.cli import options
from bcid.cli.completion import complete_saved_models
from bcid.cli.limits import LIMITS
from bcid.cli.options import Format
from bcid.errors import UsageError

if TYPE_CHECKING:
    from bcid.files.outputs import MayReplace
    from bcid.simulation.car import Plant, Sensor
    from bcid.simulation.samples import SampleTake

DEFAULT_DURATION_S = 300.0
DEFAULT_FOLDER = Path("simulated")
OTHER_TAKE = "give the take another NAME or --out"


def simulate(
    name: Annotated[str, typer.Argument(help="The take's name.")] = "simulated",
    out: Annotated[Path, typer.Option("--out", help="The folder to write to.")] = DEFAULT_FOLDER,
    duration: Annotated[
        float | None,
        typer.Option(
            min=LIMITS.min_drive_s,
            max=LIMITS.max_drive_s,
            help="Length in seconds.",
            show_default="300, or as --commands",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of driver, floor and noise.")] = 1,
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
        str | None,
        typer.Option(
            "--model",
            "-m",
            help="A saved model, by name or folder, to drive instead of the car.",
            autocompletion=complete_saved_models,
        ),
    ] = None,
    commands: Annotated[Path | None, typer.Option("--commands", help="The commands file that --model drives.")] = None,
    pipeline: options.WorkspaceOption = None,
    effects: options.EffectsOption = None,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Drive the simulated car, or a saved model, and write logs as a lab would; for the car its true motion, too."""
    from bcid.cli.sink import Sink
    from bcid.files.names import is_plain_name
    from bcid.simulation import samples
    from bcid.simulation.car import configure_simulation

    sink = Sink(format)
    if (model is None) != (commands is None):
        raise UsageError("--model and --commands go together\n  next: name the model's folder and a commands file")
    if model is not None and (ideal or sample_logs is not None):
        raise UsageError("a saved model is driven as it is\n  next: leave --ideal and --sample-logs out")
    if not is_plain_name(name):
        raise UsageError(f"{name!r} is no plain name\n  next: name the folder with --out")
    if recorder not in ("motive", "mcap"):
        raise UsageError(f"there is no recorder {recorder!r}\n  next: choose motive or mcap")
    plant, sensor = configure_simulation(ideal, change or [], rate)
    take = samples.SampleTake(name, recorder, duration or 0.0)

    def may_replace(path: Path) -> bool:
        return force

    if effects is not None and model is None:
        raise UsageError("--effects goes with --model\n  next: name the model that has them")
    with sink.stage("simulate") as progress, options.own_effects(effects):
        if sample_logs is not None:
            paths = _write_samples(sample_logs, seed, may_replace, lambda text: progress(0.0, text))
            notes = []
        elif model is not None and commands is not None:
            from bcid.cli.driving import check_only_noise_is_set, write_model_drive
            from bcid.pipeline.named_models import find_model

            check_only_noise_is_set(change or [])
            folder = find_model(model, lambda: options.workspace_of(pipeline))
            paths, warnings = write_model_drive(out, take, folder, commands, sensor, seed, may_replace)
            notes = [f"warning: {text}" for text in warnings]
        else:
            take = take._replace(duration_s=duration or DEFAULT_DURATION_S)
            paths = [_write_take(out, take, plant, sensor, seed, may_replace)]
            notes = [f"next: bcid ingest --check {paths[0]} --vehicle {out / samples.VEHICLE_FILE}"]
    sink.result(
        {"schema": "bcid.simulate/1", "recordings": [str(p) for p in paths]}, lambda: "\n".join(map(str, paths))
    )
    for text in notes:
        sink.note(text)


def _write_samples(folder: Path, seed: int, may_replace: MayReplace, progress: Callable[[str], None]) -> list[Path]:
    """Simulate all takes of the sample logs and write them into `folder`; returns the paths of their logs."""
    from bcid.files.outputs import refuse_to_overwrite, staged_outputs
    from bcid.simulation import samples

    names = (*samples.SAMPLE_TEXTS, *samples.sample_files(samples.TAKES))
    refuse_to_overwrite([folder / name for name in names], may_replace)
    with staged_outputs(folder, may_replace) as staged:
        logs = samples.write_sample_logs(staged, seed, progress)
    return [folder / log.name for log in logs]


def _write_take(
    folder: Path, take: SampleTake, plant: Plant, sensor: Sensor, seed: int, may_replace: MayReplace
) -> Path:
    """Simulate a take and write it into `folder`, with the car's vehicle file where there is none; returns its path."""
    from bcid.files.outputs import refuse_to_overwrite, staged_outputs
    from bcid.simulation import samples

    refuse_to_overwrite([folder / file for file in samples.sample_files([take])], may_replace, OTHER_TAKE)
    with staged_outputs(folder, may_replace, OTHER_TAKE) as staged:
        log = samples.write_sample_take(staged, take, plant, sensor, seed)
        if not (folder / samples.VEHICLE_FILE).exists():
            # one that is there may have been edited, and holds for this take as well
            (staged / samples.VEHICLE_FILE).write_text(samples.VEHICLE, encoding="utf-8")
    return folder / log.name

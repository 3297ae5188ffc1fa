"""Options that several commands share, and the configuration that they make together.

Every command's module imports this one to be listed in the help, so what reads a configuration is imported later.
"""

from __future__ import annotations

import os
import shlex
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bcid.errors import UsageError

if TYPE_CHECKING:
    from bcid.pipeline.config import PipelineConfig

DEFAULT_PIPELINE_FILE = Path("pipelines/bumper_car.toml")


class Format(StrEnum):
    """Formats of results."""

    human = "human"
    json = "json"
    quiet = "quiet"


PipelineOption = Annotated[
    Path | None,
    typer.Option(
        "-p", "--pipeline", show_default=str(DEFAULT_PIPELINE_FILE),
        help="The pipeline file; its settings hold for recordings that are named, too.",
    ),
]  # fmt: skip
FormatOption = Annotated[Format, typer.Option("--format", help="Format of the results on stdout.")]
RecordingsArgument = Annotated[
    list[Path] | None,
    typer.Argument(help="Recordings to use instead of those in the pipeline file.", show_default=False),
]
VehicleOption = Annotated[Path | None, typer.Option("--vehicle", help="The vehicle file of the named recordings.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="The folder for results of the named recordings.")]
CommandsOption = Annotated[
    Path | None,
    typer.Option("--commands", help="The commands file of a Motive export, if it is not NAME.commands.csv."),
]

AllowPartialOption = Annotated[
    bool, typer.Option("--allow-partial", help="Use what can be read of a damaged MCAP file, and end with exit code 3.")
]

ForceOption = Annotated[
    bool, typer.Option("--force", help="Write over files that exist already, which is refused otherwise.")
]

IgnoreHealthOption = Annotated[
    bool, typer.Option("--ignore-health", help="Use recordings whose check says no-go all the same.")
]


def command_line() -> str:
    """The command line as it was typed, with the program's bare name and ~ for the user's folder."""
    home = f"{Path.home()}{os.sep}"

    def quote(word: str) -> str:
        """One word of the line as a shell reads it."""
        return f"~{os.sep}{shlex.quote(word.removeprefix(home))}" if word.startswith(home) else shlex.quote(word)

    return " ".join(["bcid", *map(quote, sys.argv[1:])])


def read_config(
    pipeline: Path | None = None,
    recordings: list[Path] | None = None,
    vehicle: Path | None = None,
    out: Path | None = None,
    commands: Path | None = None,
    allow_partial: bool = False,
    force: bool = False,
    ignore_health: bool = False,
) -> PipelineConfig:
    """Return the configuration of the pipeline file, or one for the recordings named on the command line.

    For named recordings the settings are those of the pipeline file if one is named, and the defaults otherwise.

    Raises:
        UsageError: options that do not go together.
        InputRefused: the pipeline file has problems.
    """
    from bcid.pipeline.config import PipelineConfig, read_pipeline_file

    said = {
        "allow_partial": allow_partial, "force": force, "ignore_health": ignore_health, "command": command_line(),
    }  # fmt: skip
    if not recordings:
        if vehicle or out or commands:
            raise UsageError("--vehicle, --out and --commands go with recordings\n  next: name recordings, or use -p")
        return read_pipeline_file(pipeline or DEFAULT_PIPELINE_FILE).model_copy(update=said)
    if commands is not None and len(recordings) > 1:
        raise UsageError("--commands goes with one recording\n  next: name the others' commands NAME.commands.csv")
    missing = {"--vehicle VEHICLE.toml": (vehicle or pipeline) is None, "--out DIR": out is None}
    if any(missing.values()):
        needed = " and ".join(option for option, is_missing in missing.items() if is_missing)
        raise UsageError(f"recordings need {needed}\n  next: `bcid init` writes a vehicle file")
    if pipeline is not None:
        config = read_pipeline_file(pipeline)
    else:
        config = PipelineConfig(source="the command line", vehicle=Path(), training=recordings)
    return config.model_copy(update={
        "training": recordings, "validation": None, "truth": None, "commands": commands, "workspace": out,
        "vehicle": vehicle or config.vehicle, **said,
    })  # fmt: skip

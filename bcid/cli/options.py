"""Options that several commands share, and the configuration that they make together.

Every command's module imports this one to be listed in the help, so what reads a configuration is imported later.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bcid.errors import UsageError

if TYPE_CHECKING:
    from bcid.execution.jobs import Workers
    from bcid.pipeline.config import PipelineConfig

PIPELINE_FILE = Path("pipeline.toml")
"""The pipeline file that is found where none is named: `bcid init` writes it."""
SAMPLE_PIPELINE_FILE = Path("pipelines/bumper_car.toml")
"""That of the sample logs, which is found in a checkout of bcid."""


Note = Callable[[str], None]
"""What is told to people on stderr."""


class Format(StrEnum):
    """Formats of results."""

    human = "human"
    json = "json"
    quiet = "quiet"


PipelineOption = Annotated[
    Path | None,
    typer.Option(
        "-p", "--pipeline", show_default="pipeline.toml of this folder",
        help="The pipeline file; its settings hold for recordings that are named, too.",
    ),
]  # fmt: skip
WorkspaceOption = Annotated[
    Path | None,
    typer.Option(
        "-p", "--pipeline", show_default="pipeline.toml of this folder",
        help="The pipeline file in whose workspace a model's name is looked up.",
    ),
]  # fmt: skip
LookupOption = Annotated[
    Path | None,
    typer.Option(
        "-p", "--pipeline", show_default="pipeline.toml of this folder",
        help="The pipeline file by whose settings a recording is read, and in whose workspace a model's name is "
        "looked up.",
    ),
]  # fmt: skip
FormatOption = Annotated[Format, typer.Option("--format", help="Format of the results on stdout.")]
RecordingsArgument = Annotated[
    list[Path] | None,
    typer.Argument(help="Recordings to use instead of those in the pipeline file.", show_default=False),
]
VehicleOption = Annotated[
    Path | None,
    typer.Option(
        "--vehicle", help="The vehicle file of the named recordings.", show_default="that of the pipeline file"
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        "--out", help="The folder for results of the named recordings.", show_default="the pipeline file's workspace"
    ),
]
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

EffectsOption = Annotated[
    Path | None,
    typer.Option("--effects", help="A Python file of effects of your own, tried beside the built-in ones. It is run."),
]

SimulationOption = Annotated[
    str | None,
    typer.Option(
        "--simulation",
        help="What to compare with: the folder of a saved newton-euler model, a TOML file of its parameters, another "
        "simulator's recording of the same car, or module:function. Default: newton-euler, refitted on the recordings.",
    ),
]

DaskOption = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS",
        help="The scheduler of a Dask cluster whose workers do it, such as tcp://desk:8786.",
    ),
]  # fmt: skip


def choose_workers(workers: int, dask: str | None) -> Workers:
    """Where work is done: in so many processes of this machine, or on the Dask cluster at an address.

    Raises:
        UsageError: both are named.
    """
    if dask is None:
        return workers or os.cpu_count() or 1
    if workers:
        raise UsageError("processes of this machine and --dask exclude each other\n  next: leave one of them out")
    from bcid.execution.cluster import Cluster

    return Cluster(dask)


@contextmanager
def own_effects(file: Path | None) -> Iterator[None]:
    """Context in which the effects of a user's `file`, if one is named, belong to the vocabulary.

    Raises:
        InputRefused: the file or one of its effects is wrong.
    """
    if file is None:
        yield
        return
    from bcid.effects.own_file import own_effects_in_use, read_own_effects

    with own_effects_in_use(read_own_effects(file)):
        yield


def find_pipeline_file() -> Path | None:
    """The pipeline file that is meant where none is named: pipeline.toml of this folder, or that of the sample logs."""
    return next((path for path in (PIPELINE_FILE, SAMPLE_PIPELINE_FILE) if path.exists()), None)


def read_pipeline(pipeline: Path | None, note: Note = lambda text: None) -> PipelineConfig:
    """The configuration of the pipeline file that is named, or that is found; `note` is told of one that is found.

    The user's effects that a file names are code, and one that was only found runs none.

    Raises:
        InputRefused: there is none, or it has problems.
    """
    from bcid.pipeline.config import read_pipeline_file

    chosen = pipeline or find_pipeline_file()
    if pipeline is None and chosen is not None:
        note(f"pipeline file: {chosen}")
    config = read_pipeline_file(chosen or PIPELINE_FILE)
    return config.model_copy(update={"effects_named": pipeline is not None})


def workspace_of(pipeline: Path | None) -> Path | None:
    """The workspace of the pipeline file that is named, or that is found; None where there is none to be found.

    Raises:
        InputRefused: a pipeline file that is named is not there, or it has problems.
    """
    return read_pipeline(pipeline).workspace if pipeline or find_pipeline_file() else None


def command_line() -> str:
    """The command line as it was typed, with the program's bare name and a short form of the user's folder."""
    home, on_windows = f"{Path.home()}{os.sep}", os.name == "nt"
    return " ".join(["bcid", *(quote_word(word, home, on_windows) for word in sys.argv[1:])])


def quote_word(word: str, home: str, on_windows: bool) -> str:
    r"""One word of a command line as a shell reads it, with the user's folder `home` as ~, or as Windows writes it.

    >>> quote_word("/home/me/my takes/a.csv", "/home/me/", on_windows=False)
    "~/'my takes/a.csv'"
    >>> print(quote_word("C:\\me\\my takes\\a.csv", "C:\\me\\", on_windows=True))
    "%USERPROFILE%\my takes\a.csv"
    """
    if on_windows:
        import subprocess

        return subprocess.list2cmdline([word.replace(home, "%USERPROFILE%\\", 1) if word.startswith(home) else word])
    return f"~/{shlex.quote(word.removeprefix(home))}" if word.startswith(home) else shlex.quote(word)


def read_config(
    pipeline: Path | None = None,
    recordings: list[Path] | None = None,
    vehicle: Path | None = None,
    out: Path | None = None,
    commands: Path | None = None,
    allow_partial: bool = False,
    force: bool = False,
    ignore_health: bool = False,
    note: Note = lambda text: None,
    effects: Path | None = None,
) -> PipelineConfig:
    """Return the configuration of the pipeline file, or one for the recordings named on the command line.

    For named recordings the settings are those of the pipeline file if one is named, or if one is found in this folder
    and no vehicle file is named, and the defaults otherwise; such a file gives vehicle file and workspace as well,
    where the command line does not.  `note` is told which pipeline file was found.

    Raises:
        UsageError: options that do not go together.
        InputRefused: the pipeline file has problems.
    """
    from bcid.pipeline.config import PipelineConfig

    said: dict[str, Any] = {
        "allow_partial": allow_partial, "force": force, "ignore_health": ignore_health, "command": command_line(),
    }  # fmt: skip
    said |= {} if effects is None else {"effects": effects, "effects_named": True}
    if not recordings:
        if vehicle or out or commands:
            raise UsageError("--vehicle, --out and --commands go with recordings\n  next: name recordings, or use -p")
        return read_pipeline(pipeline, note).model_copy(update=said)
    if commands is not None and len(recordings) > 1:
        raise UsageError("--commands goes with one recording\n  next: name the others' commands NAME.commands.csv")
    found = PIPELINE_FILE.exists() and vehicle is None
    if pipeline is not None or found:
        config = read_pipeline(pipeline, note)
    else:
        config = PipelineConfig(source="the command line", vehicle=Path(), training=recordings)
        missing = {"--vehicle VEHICLE.toml": vehicle is None, "--out DIR": out is None}
        if any(missing.values()):
            needed = " and ".join(option for option, is_missing in missing.items() if is_missing)
            raise UsageError(
                f"recordings need {needed}\n  next: `bcid init` writes a vehicle file and a pipeline file; beside a "
                "pipeline.toml neither is needed"
            )
    return config.model_copy(update={
        "training": recordings, "validation": None, "truth": None, "diagnose": [], "commands": commands,
        "workspace": out or config.workspace, "vehicle": vehicle or config.vehicle, **said,
    })  # fmt: skip

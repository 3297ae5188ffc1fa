"""The options that several commands share, and the plan that they make together."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bcid.cli.sink import Format
from bcid.errors import PartLost, UsageError
from bcid.models.table import FITTED
from bcid.pipeline.plan import DEFAULT, EstimateTable, Plan, ReportTable, read_plan
from bcid.pipeline.run import Pipeline

LONGEST_S = 7200.0  # of a simulated drive

PipelineOption = Annotated[
    Path | None,
    typer.Option(
        "-p", "--pipeline", show_default=str(DEFAULT),
        help="The pipeline file; with recordings named, its settings are used for them.",
    ),
]  # fmt: skip
FormatOption = Annotated[Format, typer.Option("--format", help="How results are written to stdout.")]
Recordings = Annotated[
    list[Path] | None, typer.Argument(help="Recordings to use instead of the pipeline file's.", show_default=False)
]
VehicleOption = Annotated[Path | None, typer.Option("--vehicle", help="The vehicle file, with recordings named.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="The workspace, with recordings named.")]
CommandsOption = Annotated[
    Path | None, typer.Option("--commands", help="A Motive export's commands file, where it is not NAME.commands.csv.")
]

AllowPartialOption = Annotated[
    bool, typer.Option("--allow-partial", help="Use what is whole of a damaged MCAP file; ends with exit code 3.")
]


def plan_of(
    pipeline: Path | None = None,
    recordings: list[Path] | None = None,
    vehicle: Path | None = None,
    out: Path | None = None,
    commands: Path | None = None,
    allow_partial: bool = False,
) -> Plan:
    """The pipeline file's plan, or one of the recordings named on the command line with its or default settings.

    Raises:
        UsageError: words that do not fit together.
        InputRefused: what is wrong with the pipeline file.
    """
    if not recordings:
        if vehicle or out or commands:
            raise UsageError("--vehicle, --out and --commands go with recordings\n  next: name recordings, or use -p")
        return read_plan(pipeline or DEFAULT).model_copy(update={"allow_partial": allow_partial})
    if commands is not None and len(recordings) > 1:
        raise UsageError("--commands goes with one recording\n  next: name the others' commands NAME.commands.csv")
    if out is None or (vehicle is None and pipeline is None):
        raise UsageError(
            "recordings need --vehicle VEHICLE.toml and --out DIR\n  next: `bcid init` writes a vehicle file"
        )
    if pipeline is not None:
        plan = read_plan(pipeline)
    else:
        plan = Plan(
            source="the command line", vehicle=Path(), training=(), validation=None, truth=None, workspace=out, seed=1,
            models=tuple(FITTED), estimate=EstimateTable(), fit={}, report=ReportTable(),
        )  # fmt: skip
    takes = {
        "training": tuple(recordings), "validation": None, "truth": None, "commands": commands,
        "allow_partial": allow_partial,
    }  # fmt: skip
    return plan.model_copy(update={**takes, "workspace": out, "vehicle": vehicle or plan.vehicle})


def end(work: Pipeline) -> None:
    """Raise `PartLost` where a part of the recordings was left out."""
    lost = work.lost()
    if lost:
        raise PartLost(f"a part of the input is lost: {'; '.join(lost)}\n  next: repair or record it again")

"""`bcid predict`: pose and twist that a saved model predicts, with their covariance, as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bcid.cli import options
from bcid.cli.completion import complete_saved_models
from bcid.cli.options import Format
from bcid.errors import UsageError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bcid.cli.sink import Sink
    from bcid.prediction.prediction import Prediction
    from bcid.prediction.start import Moment, State

DEFAULT_TABLE = Path("prediction.csv")
OTHER_TABLE = "name another file with --out"
SHOWN_ROWS = 6
"""Rows of the table that is printed, from the start to the end of the prediction."""


def predict(
    model: Annotated[
        str,
        typer.Argument(
            help="The name of a saved model, or its folder.", show_default=False, autocompletion=complete_saved_models
        ),
    ],
    commands: Annotated[
        Path | None,
        typer.Option(
            "--commands",
            help="The commands file that is driven; its time 0 is the start.",
            show_default="those of the recording",
        ),
    ] = None,
    recording: Annotated[Path | None, typer.Option("--from", help="A recording, to start from --at in it.")] = None,
    recorded_commands: Annotated[
        Path | None,
        typer.Option(
            "--from-commands", help="The commands file of --from, if it is not NAME.commands.csv.", show_default=False
        ),
    ] = None,
    at: Annotated[float | None, typer.Option("--at", min=0.0, help="The moment in the recording (s).")] = None,
    state: Annotated[
        str,
        typer.Option(help="What to start from instead, SI: x, y, yaw, v_x, v_y, yaw_rate, delta as NAME=NUMBER,…"),
    ] = "",
    sd: Annotated[str, typer.Option(help="Standard deviations of the --state, written as it is.")] = "",
    duration: Annotated[
        float | None,
        typer.Option(help="Time to predict (s).", show_default="as long as there are commands"),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The table to write, .csv or .parquet.")] = DEFAULT_TABLE,
    vehicle: options.VehicleOption = None,
    pipeline: options.LookupOption = None,
    effects: options.EffectsOption = None,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Predict pose and twist with a saved model, from a state or a moment of a recording, with 95 % intervals."""
    from bcid.cli.sink import Sink
    from bcid.files.outputs import refuse_to_overwrite, write_output
    from bcid.pipeline.named_models import find_model
    from bcid.prediction.fitted_model import load_fitted_model
    from bcid.prediction.start import State
    from bcid.prediction.table import check_ending
    from bcid.recording.cuts import without_cut
    from bcid.recording.formats.detect import COMMANDS_ENDING

    sink = Sink(format)
    check_ending(out)
    _check_start(recording, recorded_commands, at, state, sd, vehicle, pipeline)
    if recording is None and commands is None:
        raise UsageError("a prediction from a state needs commands\n  next: name a file with --commands")
    file = None if recording is None else without_cut(recording)
    beside = None if file is None else file.with_suffix(COMMANDS_ENDING)
    if out.resolve() in [path.resolve() for path in (commands, file, recorded_commands, beside) if path is not None]:
        raise UsageError(f"{out} would be written over\n  next: {OTHER_TABLE}")
    refuse_to_overwrite([out], lambda path: force, OTHER_TABLE)
    # all that uses the model: its steps and the variations of its constants read the vocabulary, not the loading alone
    with options.own_effects(effects):
        fitted = load_fitted_model(find_model(model, lambda: options.workspace_of(pipeline)))
        start: State | Moment = State.parse(state, sd)
        if recording is not None and at is not None:
            start = _estimate_moment(recording, recorded_commands, at, vehicle, pipeline, fitted.period_s, sink)
        with sink.stage("predict"):
            prediction = fitted.predict_quietly(commands, start, duration)
    write_output(out, prediction.write_rows, lambda path: force, OTHER_TABLE)
    sink.result(_as_json(prediction, out), lambda: _table(prediction, fitted.name))
    for text in prediction.exits:
        sink.note(f"warning: beyond the data it was fitted on: {text}")
    if fitted.validity is None:
        sink.note("warning: no limits.json beside the model: the range of its data is not known")
    sink.note(f"{prediction.describe_covariance()}\nwritten to: {out}")


def _check_start(
    recording: Path | None, recorded_commands: Path | None, at: float | None, state: str, sd: str,
    vehicle: Path | None, pipeline: Path | None,
) -> None:  # fmt: skip
    """Raise `UsageError` unless the options say one start: a moment of a recording, or a state."""
    if (recording is None) != (at is None):
        raise UsageError("--from and --at go together\n  next: name a recording and a moment in it, in seconds")
    if recording is not None and (state or sd):
        raise UsageError("a prediction starts from a recording or from a state\n  next: leave --from or --state out")
    if recording is not None and vehicle is None and pipeline is None and options.find_pipeline_file() is None:
        raise UsageError("--from needs --vehicle VEHICLE.toml or -p PIPELINE.toml\n  next: name one of them")
    for option, given in (("--vehicle", vehicle), ("--from-commands", recorded_commands)):
        if recording is None and given:
            raise UsageError(f"{option} goes with --from\n  next: name a recording, or leave it out")


def _estimate_moment(
    recording: Path, commands: Path | None, at: float, vehicle: Path | None, pipeline: Path | None, period_s: float,
    sink: Sink,
) -> Moment:  # fmt: skip
    """The moment `at` (s) of a recording with its `commands`, whose motion is estimated every `period_s` (s)."""
    from bcid.pipeline.single_take import estimate_take
    from bcid.prediction.start import Moment

    settings = pipeline if vehicle or pipeline else options.find_pipeline_file()
    return Moment(estimate_take(recording, vehicle, settings, None, period_s, commands, sink), at)


def _as_json(prediction: Prediction, out: Path) -> dict[str, Any]:
    """What is printed as JSON: where the table lies, the ends of the prediction, and what is to be known of it."""
    return {
        "schema": "bcid.predict/1", "file": str(out), "rows": len(prediction),
        "from_s": float(prediction.time_s[0]), "to_s": float(prediction.time_s[-1]),
        "sources": list(prediction.sources), "caveats": list(prediction.caveats), "beyond": list(prediction.exits),
    }  # fmt: skip


def _table(prediction: Prediction, name: str) -> RenderableType:
    """A few rows of the prediction with half widths of their 95 % intervals."""
    import numpy as np

    from bcid.cli.sink import plain_table

    rows = np.unique(np.linspace(0, len(prediction) - 1, SHOWN_ROWS).round().astype(int))
    motion, half = np.hstack([prediction.pose, prediction.twist]), prediction.half_width
    columns = ["t (s)", "x (m)", "y (m)", "yaw (rad)", "v_x (m/s)", "v_y (m/s)", "yaw rate (rad/s)"]
    cells = [
        [f"{prediction.time_s[k]:.2f}", *(f"{v:.3f} ± {h:.3f}" for v, h in zip(motion[k], half[k], strict=True))]
        for k in rows
    ]
    return plain_table(f"{name} predicts, ± half a 95 % interval", columns, cells)

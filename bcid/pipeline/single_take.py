"""The motion of one recording, estimated as the pipeline does it, for whoever needs nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from bcid.errors import UsageError
from bcid.estimate.saving import load_estimate
from bcid.estimate.types import Estimate
from bcid.pipeline.config import PipelineConfig, read_pipeline_file
from bcid.pipeline.run import Pipeline
from bcid.pipeline.watching import Watcher

OWN_SOURCE = "what names the recording"


def estimate_take(
    recording: Path, vehicle: Path | None = None, pipeline: Path | None = None, workspace: Path | None = None,
    period_s: float | None = None, commands: Path | None = None, watcher: Watcher | None = None,
) -> Estimate:  # fmt: skip
    """The smoothed motion of a recording, by the settings of a pipeline file or, for a vehicle file, the usual ones.

    With a pipeline file the filter is tuned to its training takes and everything is kept in its workspace; else it is
    tuned to the recording itself, and kept in `workspace` if one is named.

    Args:
        recording: its file, of any format.
        vehicle: its vehicle file; None for that of the pipeline file.
        pipeline: a pipeline file, whose settings hold.
        workspace: the folder of what is kept, another one than the pipeline file's.
        period_s: the grid's period (s), another one than that of the settings.
        commands: the commands file of a Motive export, if it is not NAME.commands.csv.
        watcher: what is told of the stages as they run.

    Raises:
        UsageError: neither a vehicle file nor a pipeline file is named.
        InputRefused: a file cannot be used.
    """
    if pipeline is not None:
        config = read_pipeline_file(pipeline)
    elif vehicle is not None:
        config = PipelineConfig(source=OWN_SOURCE, vehicle=vehicle, training=[recording])
    else:
        raise UsageError(f"{recording} needs a vehicle file\n  next: name one, or a pipeline file")
    grid = config.estimate if period_s is None else config.estimate.model_copy(update={"period_s": period_s})
    with _folder_or_temporary(workspace or (config.workspace if pipeline is not None else None)) as home:
        changed = {"vehicle": vehicle or config.vehicle, "estimate": grid, "commands": commands, "workspace": home}
        made = Pipeline(config.model_copy(update=changed), watcher).estimate(recording)
        return load_estimate(made.folder)


@contextmanager
def _folder_or_temporary(folder: Path | None) -> Iterator[Path]:
    """Context with the folder, or with a new one that is removed afterwards where it is None."""
    if folder is not None:
        yield folder
        return
    with TemporaryDirectory() as temporary:
        yield Path(temporary)

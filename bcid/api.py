"""The interface in Python: the words of the command line as functions, over the same pipeline and with its results.

Paths may be texts.  What is made is kept in the folder `out`, or in the workspace of a pipeline file, as the commands
keep it there: what was made once is read again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from bcid.adaptation.settings import FORGET_S
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.report import ReportDocument
from bcid.errors import UsageError
from bcid.prediction.fitted_model import AT_REST, Commands, FittedModel, load_fitted_model
from bcid.prediction.start import Moment, State

if TYPE_CHECKING:
    from bcid.adaptation.on_line import AdaptedCar
    from bcid.documents.export import ExportDocument
    from bcid.estimate.types import Estimate
    from bcid.models.settings import CarLoss
    from bcid.pipeline.config import PipelineConfig
    from bcid.prediction.prediction import Prediction
    from bcid.recording.types import Recording

AnyPath = str | PathLike[str]
OWN_SOURCE = "bcid in Python"


@dataclass(frozen=True)
class Comparison:
    """Models compared on a take that none has seen: the document, and the page that shows it."""

    document: ReportDocument
    page: Path


@dataclass(frozen=True)
class DiagnosedRecordings:
    """What physics recordings show that a model lacks: the document, the car with what was found, and the page."""

    document: DiagnosisDocument
    model: FittedModel
    page: Path

    @property
    def sentence(self) -> str:
        """What was found, in a sentence for people."""
        from bcid.report.verdict_words import verdict_sentence

        return verdict_sentence(self.document)


@contextmanager
def own_effects(file: AnyPath) -> Iterator[None]:
    """Context in which the effects of a Python file of yours can be diagnosed, and models that have them be used.

    The file is run: name only one that you wrote or have read (docs/own_effects.md).  Load such a model, and predict
    with it, within the context.

    Raises:
        InputRefused: the file or one of its effects is wrong.
        UsageError: the effects of another file are in use.
    """
    from bcid.effects.own_file import own_effects_in_use, read_own_effects

    with own_effects_in_use(read_own_effects(Path(file))):
        yield


def read(recording: AnyPath, vehicle: AnyPath, commands: AnyPath | None = None) -> Recording:
    """Read a recording of any format: poses and commands, checked and mended as `bcid ingest` does it.

    Args:
        recording: its file, or a part of it such as "take.csv[12:40]", in seconds after its first pose.
        vehicle: its vehicle file.
        commands: the commands file of a Motive export, if it is not NAME.commands.csv.

    Raises:
        InputRefused: a file cannot be used; the message says why and what to do.
    """
    from bcid.recording.cuts import read_named_recording
    from bcid.vehicle import read_vehicle

    return read_named_recording(Path(recording), read_vehicle(Path(vehicle)), _path(commands))


def estimate_motion(
    recording: AnyPath,
    vehicle: AnyPath | None = None,
    *,
    out: AnyPath | None = None,
    pipeline: AnyPath | None = None,
    period_s: float | None = None,
    commands: AnyPath | None = None,
) -> Estimate:
    """Estimate velocities and slip angles from recorded poses, as `bcid estimate` does it.

    Args:
        recording: its file.
        vehicle: its vehicle file; None for that of the pipeline file.
        out: the folder of what is kept; None keeps nothing, or uses the pipeline file's workspace.
        pipeline: a pipeline file, to whose training takes the filter is tuned; None tunes it to the recording.
        period_s: the time (s) between rows, if it is not that of the settings.
        commands: the commands file of a Motive export, if it is not NAME.commands.csv.

    Raises:
        UsageError: neither a vehicle file nor a pipeline file is named.
        InputRefused: a file cannot be used.
    """
    from bcid.pipeline.single_take import estimate_take

    return estimate_take(
        Path(recording), _path(vehicle), _path(pipeline), _path(out), period_s, _path(commands)
    )  # fmt: skip


def fit(
    recordings: AnyPath | Sequence[AnyPath] = (),
    model: str = "newton-euler",
    *,
    vehicle: AnyPath | None = None,
    out: AnyPath | None = None,
    pipeline: AnyPath | None = None,
    loss: CarLoss | None = None,
    ignore_health: bool = False,
) -> FittedModel:
    """Fit a model to recordings, as `bcid fit` does it.

    Args:
        recordings: their files; none for the training takes of the pipeline file.
        model: the model's name, one of those that `bcid models` lists.
        vehicle: the vehicle file; None for that of the pipeline file.
        out: the folder of what is kept; None for the workspace of the pipeline file.
        pipeline: a pipeline file, whose settings hold.
        loss: "one-step", "rollout" or "poses"; None for that of the settings.
        ignore_health: whether recordings whose check says no-go are used all the same.

    Raises:
        UsageError: arguments are missing or do not go together, or there is no such model.
        InputRefused: a file cannot be used, or no model can be fitted to it.
    """
    from bcid.models.table import fittable_row
    from bcid.pipeline.run import Pipeline

    row = fittable_row(model)
    if loss is not None and row.losses and loss not in row.losses:
        raise UsageError(f"{model} is not fitted on {loss}\n  next: choose {' or '.join(row.losses)}")
    config = _configure(recordings, vehicle, out, pipeline).model_copy(update={"ignore_health": ignore_health})
    work = Pipeline(config if loss is None else config.with_loss(loss))
    return load_fitted_model(work.fit(model).folder)


def compare(
    models: Iterable[str | AnyPath | FittedModel] = (),
    validation: AnyPath | None = None,
    recordings: AnyPath | Sequence[AnyPath] = (),
    *,
    vehicle: AnyPath | None = None,
    out: AnyPath | None = None,
    pipeline: AnyPath | None = None,
) -> Comparison:
    """Compare models in closed loop on a take that none has seen, as `bcid report` does it.

    Args:
        models: fitted models, folders of saved ones, and names of models that are fitted to the recordings first.
        validation: the take on which they are compared; None for that of the pipeline file.
        recordings: training takes, whose spread weighs the errors; none for those of the pipeline file.
        vehicle: the vehicle file; None for that of the pipeline file.
        out: the folder of what is kept; None for the workspace of the pipeline file.
        pipeline: a pipeline file, whose settings hold; its models are compared where `models` names none.

    Raises:
        UsageError: arguments are missing or do not go together.
        InputRefused: a file cannot be used, or the validation take is one that a model was fitted on.
    """
    from bcid.models.table import FITTABLE
    from bcid.pipeline.report_stage import MODELS_ALONE
    from bcid.pipeline.run import Pipeline

    config = _configure(recordings, vehicle, out, pipeline)
    asked = [m.folder if isinstance(m, FittedModel) else m for m in models]
    names = [m for m in asked if isinstance(m, str) and m in FITTABLE]
    update: dict[str, object] = {"models": config.models if pipeline is not None and not asked else names}
    if validation is not None:
        update["validation"] = Path(validation)
    work = Pipeline(config.model_copy(update=update))
    made = work.report([Path(m) for m in asked if m not in names], extent=MODELS_ALONE)
    return Comparison(ReportDocument.read(made.folder / "report.json"), made.folder / "index.html")


def diagnose(
    recordings: AnyPath | Sequence[AnyPath] = (),
    *,
    vehicle: AnyPath | None = None,
    out: AnyPath | None = None,
    pipeline: AnyPath | None = None,
    simulation: AnyPath | FittedModel | None = None,
    ignore_health: bool = False,
    effects: AnyPath | None = None,
) -> DiagnosedRecordings:
    """Name the physics that recordings show and a model lacks, as `bcid diagnose` does it.

    Args:
        recordings: their files; none for those that the pipeline file names.
        vehicle: the vehicle file; None for that of the pipeline file.
        out: the folder of what is kept; None for the workspace of the pipeline file.
        pipeline: a pipeline file, whose settings hold.
        simulation: what to compare with: a fitted newton-euler model or its folder, a TOML file of parameters, another
            simulator's recording of the same car, or module:function; None for newton-euler, refitted on the
            recordings.
        ignore_health: whether recordings whose check says no-go are used all the same.
        effects: a Python file of effects of your own, which is run; None for that of the pipeline file.  A model in
            which some were found is used within `own_effects`.

    Raises:
        UsageError: arguments are missing or do not go together.
        InputRefused: a file cannot be used.
    """
    from bcid.pipeline.run import Pipeline

    config = _configure(recordings, vehicle, out, pipeline).model_copy(update={"ignore_health": ignore_health})
    if effects is not None:
        config = config.model_copy(update={"effects": Path(effects)})
    against = simulation.folder if isinstance(simulation, FittedModel) else simulation
    work = Pipeline(config)
    folder = work.diagnose(None if against is None else str(against)).folder
    document = DiagnosisDocument.read(folder / "diagnosis.json")
    with work.runner.own_effects_of(folder / "model"):
        model = load_fitted_model(folder / "model")
    return DiagnosedRecordings(document, model, folder / "diagnosis.html")


def load(folder: AnyPath) -> FittedModel:
    """Load a saved model, with its process noise and the range of its data.

    Raises:
        InputRefused: there is no model in the folder, it is damaged, or it has effects of a user's own and their file
            is not in use (`own_effects`).
    """
    return load_fitted_model(Path(folder))


def predict(
    model: AnyPath | FittedModel,
    commands: Commands | None = None,
    start: State | Moment = AT_REST,
    duration_s: float | None = None,
) -> Prediction:
    """Predict pose and twist with their covariance, as `bcid predict` does it; see `FittedModel.predict`.

    Args:
        model: a fitted model, or the folder of a saved one.
        commands: a commands file, or an array of them; None for those of the recording from which it starts.
        start: a state, or a moment of an estimated recording.
        duration_s: the time (s) to predict; None for as long as there are commands.

    Raises:
        UsageError: the arguments do not go together, or are no commands.
        InputRefused: a file or a moment cannot be used, or the prediction runs away.
    """
    fitted = model if isinstance(model, FittedModel) else load(model)
    return fitted.predict(commands, start, duration_s, stacklevel=3)


def adapt(
    model: AnyPath | FittedModel,
    recording: AnyPath,
    quantities: Sequence[str] = ("mass",),
    *,
    vehicle: AnyPath | None = None,
    out: AnyPath | None = None,
    pipeline: AnyPath | None = None,
    forget_s: float = FORGET_S,
    ignore_health: bool = False,
) -> AdaptedCar:
    """Follow a few constants of a fitted car over a recording, as `bcid adapt` does it.

    Args:
        model: a fitted newton-euler model or the one of a diagnosis, or the folder of a saved one.
        recording: the file of a recording.
        quantities: "mass", "grip", "motor", "drag", constants such as "C_f", or parameters of effects.
        vehicle: the vehicle file; None for that of the pipeline file.
        out: the folder of what is kept; None for the workspace of the pipeline file.
        pipeline: a pipeline file, whose settings hold.
        forget_s: the time (s) after which as little is known of a quantity as at first, if a drive does not show it.
        ignore_health: whether a recording whose check says no-go is used all the same.

    Raises:
        UsageError: arguments are missing or do not go together, or one of the quantities is none of this car.
        InputRefused: a file cannot be used.
    """
    from bcid.adaptation.on_line import AdaptedCar
    from bcid.pipeline.adapted_take import adapt_over_take
    from bcid.pipeline.run import Pipeline

    config = _configure(recording, vehicle, out, pipeline).model_copy(update={"ignore_health": ignore_health})
    work, folder = Pipeline(config), model.folder if isinstance(model, FittedModel) else Path(model)
    with work.runner.own_effects_of(folder):
        taken = adapt_over_take(work, Path(recording), folder, quantities, forget_s)
    return AdaptedCar(taken.adaptation, taken.released)


def export_code(
    model: AnyPath | FittedModel,
    out: AnyPath,
    formats: Sequence[str] = (),
    name: str | None = None,
    *,
    as_vehicle: bool = False,
    time_s: float | None = None,
    force: bool = False,
) -> ExportDocument:
    """Write a model as code for other programs, each file run against the model before, as `bcid export` does it.

    Args:
        model: a fitted model, or the folder of a saved one.
        out: the folder to write to.
        formats: such as "c" or "casadi"; none for all that are possible here.
        name: what files and functions are called; None for the model's name.
        as_vehicle: whether effects of how poses were measured are left out.
        time_s: the second of the recording at which effects of its time stand still; None lets them go on.
        force: whether files that are there already are written over.

    Raises:
        UsageError: there is no such format, the name cannot be one, or the model's clock drifts and no time is given.
        InputRefused: a file is there already, or no format does what the model does.
        PartLost: a format does not do what the model does; the others are written.
    """
    from bcid.export.exported import export_model
    from bcid.export.formats import FORMATS
    from bcid.export.write import write_export

    for one in formats:
        if one not in FORMATS:
            raise UsageError(f"there is no format {one!r}\n  next: choose of {', '.join(FORMATS)}")
    fitted = model if isinstance(model, FittedModel) else load(model)
    exported = export_model(fitted.model, fitted.sha256, fitted.validity, name, as_vehicle, time_s)
    possible = [one for one in FORMATS if FORMATS[one].suits(exported) and not FORMATS[one].missing_library()]
    made = write_export(exported, list(formats) or possible, Path(out), lambda path: force, lambda share, text: None)
    made.raise_if_refused()
    return made


def _path(given: AnyPath | None) -> Path | None:
    """The path that was given, or None."""
    return None if given is None else Path(given)


def _configure(
    recordings: AnyPath | Sequence[AnyPath], vehicle: AnyPath | None, out: AnyPath | None, pipeline: AnyPath | None
) -> PipelineConfig:
    """The configuration of a pipeline file, with what else is named in the place of its entries.

    Raises:
        UsageError: without a pipeline file recordings, vehicle and out are not all named.
        InputRefused: the pipeline file has problems.
    """
    from bcid.pipeline.config import PipelineConfig, read_pipeline_file

    listed = [recordings] if isinstance(recordings, str | PathLike) else recordings
    named = [Path(recording) for recording in listed]
    if pipeline is None:
        missing = {"recordings": not named, "vehicle": vehicle is None, "out": out is None}
        if any(missing.values()):
            texts = ", ".join(name for name, is_missing in missing.items() if is_missing)
            raise UsageError(f"not given: {texts}\n  next: give recordings, vehicle and out, or a pipeline file")
        config = PipelineConfig(source=OWN_SOURCE, vehicle=Path(), training=named)
    else:
        config = read_pipeline_file(Path(pipeline))
        if named:
            # as on the command line: the file's settings hold, its other takes do not
            config = config.model_copy(update={"training": named, "validation": None, "truth": None, "diagnose": []})
    update = {"vehicle": _path(vehicle) or config.vehicle, "workspace": _path(out) or config.workspace}
    return config.model_copy(update=update)

"""`bcid fit`: models fitted to the training recordings, with their scores on the validation recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from bcid.cli import options
from bcid.cli.completion import complete_fittable_models, complete_losses
from bcid.cli.options import Format
from bcid.errors import InputRefused, UsageError

if TYPE_CHECKING:
    from bcid.cli.show_fits import ScoredFit
    from bcid.pipeline.run import Pipeline


def fit(
    recordings: options.RecordingsArgument = None,
    model: Annotated[
        list[str] | None,
        typer.Option(
            "--model", "-m", help="A model to fit; repeat for several. Default: those in the pipeline file.",
            autocompletion=complete_fittable_models,
        ),
    ] = None,
    loss: Annotated[
        str | None,
        typer.Option(
            help="one-step (the paper's), rollout, or poses (newton-euler). Default: the pipeline file's.",
            autocompletion=complete_losses,
        ),
    ] = None,
    equations: Annotated[
        bool, typer.Option("--equations", help="Print the equations with their fitted values, too.")
    ] = False,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    commands: options.CommandsOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:  # fmt: skip
    """Fit models to the training recordings and score them on the validation recording; each is saved by its name."""
    from bcid.cli import show_fits
    from bcid.cli.sink import Sink
    from bcid.models.settings import LOSSES
    from bcid.models.table import fittable_row
    from bcid.pipeline.named_models import MODEL_FILES, MODELS_FOLDER, name_of_fit
    from bcid.pipeline.run import Pipeline

    if loss is not None and loss not in LOSSES:
        raise UsageError(f"there is no loss {loss!r}\n  next: choose {' or '.join(LOSSES)}")
    for name in model or []:
        # a model without losses of its own is fitted on its base model's
        losses = fittable_row(name).losses or LOSSES
        if loss is not None and loss not in losses:
            raise UsageError(f"{name} is not fitted on {loss}\n  next: choose {' or '.join(losses)}")
    sink = Sink(format)
    config = options.read_config(
        pipeline, recordings, vehicle, out, commands, allow_partial, force, ignore_health, sink.note
    )
    names = list(dict.fromkeys(model or config.models))
    saved_as = {name: name_of_fit(name, loss, config.fit_settings(name).get("loss")) for name in names}
    work = Pipeline(config if loss is None else config.with_loss(loss), sink)
    for name in names:
        work.refuse_to_publish_over(*MODEL_FILES, to=f"{MODELS_FOLDER}/{saved_as[name]}")
    work.refuse_untrainable(names)
    for name in names:
        # one after the other, so that each is found by its name as soon as it is fitted
        work.publish_fit(work.fit(name), saved_as[name])
    fitted, unscored = _score(work, saved_as)
    sink.result(
        {"schema": "bcid.fit/1", "models": [f.as_json() for f in fitted]},
        lambda: show_fits.fit_tables(fitted, work.validation_name(), equations),
    )
    if unscored:
        sink.note(f"not scored: {unscored}")
    for text in show_fits.warnings_of_fits(fitted):
        sink.note(f"warning: {text}")
    sink.note(show_fits.next_steps(fitted))
    work.raise_if_parts_lost()


def _score(work: Pipeline, saved_as: dict[str, str]) -> tuple[list[ScoredFit], str]:
    """The fitted models, best first, with their scores on the validation recording, or why they have none."""
    from bcid.cli.show_fits import ScoredFit
    from bcid.evaluation.residuals import load_residuals
    from bcid.models.saving import load_model
    from bcid.pipeline.named_models import MODELS_FOLDER

    fitted, unscored = list[ScoredFit](), ""
    for name, saved_name in saved_as.items():
        compared, score = work.fit_for_comparison(name), None
        try:
            score = None if unscored else work.score(compared)
        except InputRefused as refusal:  # the fit is none the worse for it
            unscored = str(refusal)
        folder = work.config.workspace / MODELS_FOLDER / saved_name
        residuals, model = load_residuals(compared.folder), load_model(compared.folder)
        fitted.append(ScoredFit(saved_name, folder, compared.folder, model, residuals, score))
    far = float("inf")
    return sorted(fitted, key=lambda f: f.score.nmse if f.score and f.score.nmse is not None else far), unscored

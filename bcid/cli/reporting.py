"""`bcid report` and `bcid run`: the comparison of models on the validation recording, and everything at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from bcid.cli import options
from bcid.cli.completion import complete_compared_models
from bcid.cli.options import Format
from bcid.pipeline.named_models import WITH_REMAINDER

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bcid.cli.sink import Sink
    from bcid.pipeline.run import Pipeline
    from bcid.store.artifact import Artifact

REPORT_FILES = ("index.html", "report.json", "model_card.json")
PAGE_FILES = ("diagnosis.html", "model_card.json")
FOUND_FILES = ("diagnosis.json", "model", WITH_REMAINDER, "next_manoeuvre.commands.csv")
DIAGNOSIS_FILES = (*PAGE_FILES, *FOUND_FILES)


def run(
    pipeline: options.PipelineOption = None,
    effects: options.EffectsOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Do everything in the pipeline file: ingest, estimate, fit and compare all models, and diagnose."""
    from bcid.cli.sink import Sink
    from bcid.pipeline.report_stage import WHOLE
    from bcid.pipeline.run import Pipeline

    sink = Sink(format)
    config = options.read_config(
        pipeline, allow_partial=allow_partial, force=force, ignore_health=ignore_health, note=sink.note, effects=effects
    )  # fmt: skip
    work = Pipeline(config, sink)
    _refuse_to_publish_over(work, work.config.models)
    if work.config.diagnose:
        work.refuse_to_publish_over(*DIAGNOSIS_FILES, to="diagnosis")
        work.refuse_unusable(work.config.diagnose)
    artifact = work.report(extent=WHOLE._replace(diagnosis=False))
    _publish_fits(work, work.config.models)
    if work.config.diagnose and not work.find_diagnosis():
        page = work.publish(artifact, *REPORT_FILES, to="report")
        sink.note(f"report: {page} compares the models; the diagnosis follows, and takes some minutes")
    artifact = work.report()
    if work.config.diagnose:
        sink.note(f"diagnosis page: {publish_diagnosis(work, work.diagnose(), 'diagnosis')}")
    _show_report(work, sink, artifact)
    if not work.config.diagnose:
        sink.note("next: bcid diagnose says what physics the models lack; with `diagnose = […]`, run does so as well")


def report(
    model: Annotated[
        list[str] | None,
        typer.Option(
            "--model", "-m", autocompletion=complete_compared_models,
            help="What to compare; repeat for several. A model of the pipeline file is fitted if it is not yet; a "
            "saved one (its name or folder) is compared beside. Default: those of the pipeline file that are fitted.",
        ),
    ] = None,
    pipeline: options.PipelineOption = None,
    effects: options.EffectsOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:  # fmt: skip
    """Compare the fitted models in closed loop on the validation recording: a page, a JSON, a table."""
    from bcid.cli.sink import Sink
    from bcid.pipeline.named_models import find_model
    from bcid.pipeline.report_stage import MODELS_ALONE
    from bcid.pipeline.run import Pipeline

    sink = Sink(format)
    config = options.read_config(
        pipeline, allow_partial=allow_partial, force=force, ignore_health=ignore_health, note=sink.note, effects=effects
    )  # fmt: skip
    asked = [m for m in model or [] if m in config.models]
    saved = [find_model(m, lambda: config.workspace) for m in model or [] if m not in config.models]
    work = Pipeline(config, sink)
    _refuse_to_publish_over(work, asked)
    chosen = asked or _fitted_models(work, sink, all_if_none=not saved)
    artifact = work.report(saved, chosen, MODELS_ALONE)
    _publish_fits(work, chosen)
    _show_report(work, sink, artifact)


def publish_diagnosis(work: Pipeline, artifact: Artifact, home: str) -> Path:
    """Publish a diagnosis with its page in the folder `home` of the workspace; return the page's path."""
    page = work.diagnosis_page(artifact)
    work.publish(artifact, *FOUND_FILES, to=home)
    return work.publish(page, *PAGE_FILES, to=home)


def _fitted_models(work: Pipeline, sink: Sink, all_if_none: bool) -> list[str]:
    """Models of the pipeline file that are fitted already; all of them where none is and `all_if_none`.

    People are told which are left out, or that the fits come first.
    """
    fitted = [m for m in work.config.models if work.find_fit(m)]
    missing = [m for m in work.config.models if m not in fitted]
    if fitted and missing:
        sink.note(f"not fitted yet, so not compared: {', '.join(missing)} (`bcid fit` or `bcid run` fits them)")
    if fitted or not all_if_none:
        return fitted
    sink.note(f"no model is fitted yet, so this comes first: {', '.join(missing)}")
    return missing


def _refuse_to_publish_over(work: Pipeline, models: Sequence[str]) -> None:
    """Raise `InputRefused` where a report, or a copy of one of `models`, could not be put where it belongs."""
    from bcid.pipeline.named_models import MODEL_FILES, MODELS_FOLDER

    work.refuse_to_publish_over(*REPORT_FILES, to="report")
    for name in models:
        work.refuse_to_publish_over(*MODEL_FILES, to=f"{MODELS_FOLDER}/{name}")


def _publish_fits(work: Pipeline, models: Sequence[str]) -> None:
    """Put copies of the fitted `models` where they are found by name."""
    for name in models:
        work.publish_fit(work.fit(name), name)


def _show_report(work: Pipeline, sink: Sink, artifact: Artifact) -> None:
    """Publish a report and print its table, the diagnosis in short where there is one, and where the page lies."""
    from bcid.cli import show
    from bcid.documents.report import ReportDocument

    page: Path = work.publish(artifact, *REPORT_FILES, to="report")
    document = ReportDocument.read(artifact.folder / "report.json")
    sink.result(document.as_json(), lambda: show.comparison_table(document))
    if document.diagnosis:
        sink.note(f"diagnosis: {document.diagnosis.sentence}")
    sink.note(f"report: {page}")
    work.raise_if_parts_lost()

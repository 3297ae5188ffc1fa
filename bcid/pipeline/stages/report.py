"""Stage `report`: the comparison as one offline page and one JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.report import EvaluationDocument, LossScore
from bcid.estimate.consistency import TruthCheck
from bcid.estimate.saving import EstimateSummary, load_estimate
from bcid.evaluation.closed_loop import time_rollout_ms
from bcid.evaluation.validity import DataRange
from bcid.models.saving import load_model
from bcid.pipeline.model_card import Origin, describe_comparison
from bcid.recording.saving import RecordingSummary
from bcid.report.content import ModelResult, PublishedFigures, ReportContent, TakeSummary, build_report
from bcid.report.page import write_report_page


class EvaluatedModel(NamedTuple):
    """A compared model: its label, the settings of its fit, and the folders of its artifact and of its evaluation."""

    label: str  # its name there
    settings: Mapping[str, Any]  # of its fit
    model: Path  # folders
    evaluation: Path
    saw_validation: bool | None = False  # None where nobody knows


class LossEvaluation(NamedTuple):
    """A model fitted by one of the losses that are compared, and the folder of its evaluation."""

    model: str
    loss: str
    evaluation: Path


def run_report_stage(
    folder: Path,
    models: Sequence[EvaluatedModel],
    validation: Path,
    takes: Sequence[tuple[Path, Path, Path | None]],
    settings: Mapping[str, Any],
    vehicle_name: str,
    diagnosis: Path | None,
    losses: Sequence[LossEvaluation] = (),
    names: Sequence[str] = (),
    origin: Origin | None = None,
) -> None:
    """Write the comparison of the evaluated models as index.html and report.json to `folder`.

    Where its `origin` is known, its card is on the page, and lies beside it as model_card.json.

    All paths are folders of artifacts; `takes` holds those of ingest, estimate and check of every recording, the
    validation take's last, `settings` is the pipeline file's table `[report]`, and `losses` are models fitted by other
    losses, compared in a table of their own.  The takes are called by `names`, or else by the names of their files.
    """
    take = load_estimate(validation)
    recorded = [RecordingSummary.read(recording / "recording.json") for recording, _, _ in takes]
    names = names or [summary.name for summary in recorded]
    results = []
    for judged in models:
        evaluation = EvaluationDocument.read(judged.evaluation / "evaluation.json")
        repeats = int(settings["timing_repeats"])
        ms = time_rollout_ms(load_model(judged.model), take, repeats) if repeats else None
        update = {"model": judged.label, "rollout_ms": ms, "saw_validation": judged.saw_validation}
        labelled = evaluation.model_copy(update=update)
        results.append(ModelResult.read(labelled, judged.settings, judged.evaluation, len(take)))
    card = None
    if origin is not None:
        *fitted, judged_on = (load_estimate(estimate) for _, estimate, _ in takes)
        driven = DataRange.from_estimates(fitted) if fitted else None
        card = describe_comparison(origin, driven, DataRange.from_estimates([judged_on]))
        card.write(folder / "model_card.json")
    content = ReportContent(
        vehicle=vehicle_name,
        validation=replace(take, name=names[-1] if names else take.name),
        models=results,
        takes=[
            TakeSummary(
                name,
                summary,
                EstimateSummary.read(estimate / "estimate.json"),
                None if check is None else TruthCheck.read(check / "check.json"),
            )
            for name, summary, (_, estimate, check) in zip(names, recorded, takes, strict=True)
        ],
        restart_s=float(settings["restart_s"]),
        diagnosis=None if diagnosis is None else DiagnosisDocument.read(diagnosis / "diagnosis.json"),
        published=PublishedFigures(**settings["published"]) if settings.get("published") else None,
        losses=[
            LossScore(**{**EvaluationDocument.read(b.evaluation / "evaluation.json").as_json(), **b._asdict()})
            for b in losses
        ],
        card=card,
    )
    build_report(content).write(folder / "report.json")
    write_report_page(content, folder / "index.html")

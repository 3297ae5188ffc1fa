"""Stage `report`: the comparison as one offline page and one JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bcid.estimate.saving import load_estimate
from bcid.evaluation.closed_loop import rollout_ms
from bcid.models.saving import load_model
from bcid.report.content import Content, ModelResult, TakeFacts, report_json
from bcid.report.page import write_page


class Judged(NamedTuple):
    """A model of the comparison."""

    label: str  # its name there
    settings: Mapping[str, Any]  # of its fit
    model: Path  # folders
    evaluation: Path


class ByLoss(NamedTuple):
    """A model fitted by one of the losses that are compared."""

    model: str
    loss: str
    evaluation: Path


def make(
    folder: Path,
    models: Sequence[Judged],
    validation: Path,
    takes: Sequence[tuple[Path | None, ...]],
    settings: Mapping[str, Any],
    vehicle_name: str,
    diagnosis: Path | None,
    losses: Sequence[ByLoss] = (),
) -> None:
    """`takes` are triples of ingest, estimate and check folders."""
    take = load_estimate(validation)
    results = []
    for judged in models:
        figures = json.loads((judged.evaluation / "evaluation.json").read_text(encoding="utf-8"))
        repeats = int(settings["timing_repeats"])
        ms = rollout_ms(load_model(judged.model), take, repeats) if repeats else None
        known = figures | {"model": judged.label, "rollout_ms": ms}
        results.append(ModelResult.read(known, judged.settings, judged.evaluation))
    names = ("recording.json", "estimate.json", "check.json")
    content = Content(
        vehicle=vehicle_name,
        validation=take,
        models=results,
        takes=[TakeFacts(*(_facts(f, n) for f, n in zip(take, names, strict=True))) for take in takes],
        restart_s=float(settings["restart_s"]),
        diagnosis=_facts(diagnosis, "diagnosis.json"),
        losses=[
            {"model": b.model, "loss": b.loss} | {k: figures[k] for k in ("nmse", "nmse_ci95", "nmse_restarted")}
            for b in losses
            for figures in [_facts(b.evaluation, "evaluation.json")]
        ],
    )
    (folder / "report.json").write_text(json.dumps(report_json(content), indent=1), encoding="utf-8")
    write_page(content, folder / "index.html")


def _facts(folder: Path | None, name: str) -> Any:
    return None if folder is None else json.loads((folder / name).read_text(encoding="utf-8"))

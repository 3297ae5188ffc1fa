"""Stage `report`: the comparison as one offline page and one JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bcid.estimate.saving import load_estimate
from bcid.evaluation.closed_loop import rollout_ms
from bcid.models.saving import load_model
from bcid.report.content import Content, ModelResult, TakeFacts, report_json
from bcid.report.page import write_page


def make(
    folder: Path,
    models: Sequence[tuple[Path, Path]],
    validation: Path,
    takes: Sequence[tuple[Path | None, ...]],
    settings: Mapping[str, Any],
    vehicle_name: str,
) -> None:
    """`models` are pairs of fit and evaluation folders, `takes` triples of ingest, estimate and check folders."""
    take = load_estimate(validation)
    results = []
    for fit, evaluation in models:
        figures = json.loads((evaluation / "evaluation.json").read_text(encoding="utf-8"))
        ms = rollout_ms(load_model(fit), take, int(settings["timing_repeats"]))
        fitted = json.loads((fit / "manifest.json").read_text(encoding="utf-8"))["settings"]
        results.append(ModelResult.read(figures | {"rollout_ms": ms}, fitted, evaluation))
    names = ("recording.json", "estimate.json", "check.json")
    content = Content(
        vehicle=vehicle_name,
        validation=take,
        models=results,
        takes=[TakeFacts(*(_facts(f, n) for f, n in zip(take, names, strict=True))) for take in takes],
        restart_s=float(settings["restart_s"]),
    )
    (folder / "report.json").write_text(json.dumps(report_json(content), indent=1), encoding="utf-8")
    write_page(content, folder / "index.html")


def _facts(folder: Path | None, name: str) -> Any:
    return None if folder is None else json.loads((folder / name).read_text(encoding="utf-8"))

"""What a report says, before it is drawn: models best first, and figures that others published of them."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.documents import report
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.model_card import ModelCard
from bcid.errors import InputRefused
from bcid.estimate.consistency import TruthCheck
from bcid.estimate.saving import EstimateSummary
from bcid.estimate.types import Estimate
from bcid.evaluation.evaluate import ROW_UNITS
from bcid.files.parquet import read_columns
from bcid.recording.saving import RecordingSummary
from bcid.report.verdict_words import verdict_sentence


@dataclass(frozen=True)
class ModelResult:
    """One model's score, and its predictions of the validation take (K rows)."""

    evaluation: report.EvaluationDocument
    settings: Mapping[str, Any]
    twist: Floats  # (K, 3) through the whole take
    restart_pose: Floats  # (K, 3)
    restart_twist: Floats  # (K, 3)
    restart: Bools  # (K,)
    half: Floats  # (K, 3) half widths of the whole rollout's 95 % interval, NaN where none is known

    @property
    def name(self) -> str:
        """The model's name in the report."""
        return self.evaluation.model

    @classmethod
    def read(
        cls, evaluation: report.EvaluationDocument, settings: Mapping[str, Any], folder: Path, count: int
    ) -> ModelResult:
        """The result of `evaluation`, with the `count` predictions in its folder's rows.parquet, NaN if they diverge.

        Raises:
            InputRefused: the file is damaged, or holds the predictions of another take.
        """
        path = folder / "rows.parquet"
        rows = read_columns(path, ROW_UNITS, undefined=[name for name in ROW_UNITS if name != "restart"])
        if len(rows) != count:
            raise InputRefused(path, "rows", f"are {len(rows)}, and those of the take {count}", "evaluate it again")
        if rows[0, 9] != 1.0:
            raise InputRefused(path, "column restart", "does not begin with a start, 1", "evaluate it again")
        return cls(evaluation, settings, rows[:, :3], rows[:, 3:6], rows[:, 6:9], rows[:, 9] > 0.5, rows[:, 10:13])


class PublishedFigures(NamedTuple):
    """Figures that others published of models of the same names, to stand beside ours: settings of the pipeline."""

    title: str
    note: str  # on what data and machine they were found
    nmse: Mapping[str, float]  # by model
    rollout_ms: Mapping[str, float]


class TakeSummary(NamedTuple):
    """What the report shows of one take: name, recording and estimate, and the check where a truth is known."""

    name: str
    recording: RecordingSummary
    estimate: EstimateSummary
    check: TruthCheck | None


@dataclass(frozen=True)
class ReportContent:
    """Everything that the report's page and JSON are made of."""

    vehicle: str
    validation: Estimate
    models: Sequence[ModelResult]
    takes: Sequence[TakeSummary]
    restart_s: float
    diagnosis: DiagnosisDocument | None = None  # None where the pipeline diagnoses nothing
    published: PublishedFigures | None = None  # None where the pipeline file names none
    losses: Sequence[report.LossScore] = ()  # figures of models fitted by several losses, with the same seed
    card: ModelCard | None = None  # where it comes from, if that is known

    def ranked_models(self) -> list[ModelResult]:
        """The models in order of their NMSE, those that diverge last, and after them those that saw the take."""

        def rank(model: ModelResult) -> tuple[bool, float]:
            score = model.evaluation
            return bool(score.saw_validation), np.inf if score.nmse is None else score.nmse

        return sorted(self.models, key=rank)


def describe_machine() -> report.Machine:
    """System, processor, cores and Python version of the machine that this runs on, and nothing that identifies it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        processor = platform.processor() or "unknown"
    system, python = f"{platform.system()} {platform.machine()}", platform.python_version()
    return report.Machine(system=system, processor=processor, cores=os.cpu_count(), python=python)


def build_report(content: ReportContent) -> report.ReportDocument:
    """The document report.json: validation take, machine, models in order of their NMSE, verdict of the diagnosis."""
    take, diagnosis = content.validation, content.diagnosis
    v_x, v_y, yaw_rate = content.models[0].evaluation.weights
    return report.ReportDocument(
        vehicle=content.vehicle,
        validation=report.Validation(
            name=take.name, duration_s=float(take.time_s[-1] - take.time_s[0]), period_s=take.period_s,
            samples=len(take), segments=len(take.segments()),
        ),
        weights=report.Weights(v_x=v_x, v_y=v_y, yaw_rate=yaw_rate),
        restart_s=content.restart_s,
        machine=describe_machine(),
        models=tuple(report.ModelScore(**m.evaluation.as_json()) for m in content.ranked_models()),
        losses=tuple(content.losses),
        diagnosis=diagnosis and report.DiagnosisInShort(
            verdict=diagnosis.verdict, effects=tuple(f.effect for f in diagnosis.findings),
            recordings=diagnosis.recordings, sentence=verdict_sentence(diagnosis),
        ),
    )  # fmt: skip

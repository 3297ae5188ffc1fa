"""The model card of a diagnosis or of a comparison: its data, when and how it was made, where it holds."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from bcid import __version__
from bcid.documents.diagnosis import BaseParameter, DiagnosisDocument
from bcid.documents.model_card import DataFile, DataSpan, ModelCard, NoiseLevel
from bcid.evaluation.validity import QUANTITIES, DataRange, load_validity
from bcid.models.interface import Model
from bcid.models.saving import load_model
from bcid.pipeline.making_date import making_date
from bcid.recording.saving import RecordingSummary

POSE_NOISE = (("position x", "m"), ("position y", "m"), ("yaw", "rad"))
DISTURBANCES = (("forward disturbance", "m/s²"), ("side disturbance", "m/s²"), ("yaw disturbance", "rad/s²"))
THROTTLE = "m/s or share"
"""The unit of the throttle, of which the vehicle file says which it is."""

BEYOND_RANGE = (
    "Motion or commands outside the ranges above: there the model extrapolates, and nobody has compared it with a car."
)
OTHER_CAR = "Another car, other tyres, another floor or another load: none of them is in the data."
OFF_THE_PLANE = "Ramps, jumps and roll-over: the model is planar, and its wheels stay on the floor."
LACKING = "Trusting ± alone: physics is missing that has no name yet, so that intervals are narrower than the truth."


class IngestedTake(NamedTuple):
    """A recording that went into a result."""

    folder: Path  # of the ingested take
    parents: str  # folders that tell its files apart from others of the same name; empty where nothing needs to
    recorded: str | None  # when, as far as its file says


@dataclass(frozen=True)
class Origin:
    """Where a result comes from: the vehicle file, the recordings, the command."""

    vehicle: str
    vehicle_file: DataFile
    recordings: Sequence[IngestedTake]
    command: str

    def card(self, **more: Any) -> ModelCard:
        """A card that says this, and when it was made: now; `more` are other fields of the card."""
        summaries = [RecordingSummary.read(take.folder / "recording.json") for take in self.recordings]
        data = tuple(
            DataFile(
                name=f"{take.parents}{source.path}",
                sha256=source.sha256,
                format=source.format,
                recorded=take.recorded if k == 0 else None,
            )
            for summary, take in zip(summaries, self.recordings, strict=True)
            for k, source in enumerate(summary.sources)
        )
        return ModelCard(
            vehicle=self.vehicle, vehicle_file=self.vehicle_file, data=data,
            duration_s=sum(s.duration_s for s in summaries), made=f"{making_date():%Y-%m-%dT%H:%M:%SZ}",
            program=f"bcid {__version__}", command=self.command, **more,
        )  # fmt: skip


def describe_diagnosed_model(origin: Origin, diagnosis: DiagnosisDocument, folder: Path) -> ModelCard:
    """The card of the augmented model that a diagnosis saved in `folder`."""
    model, validity = load_model(folder), load_validity(folder)
    found = [
        BaseParameter(symbol=f"{name}.{symbol}", **q.model_dump())
        for name, parameters in [
            *((f.effect, f.parameters) for f in diagnosis.findings),
            *((c.correction, c.parameters) for c in diagnosis.corrections),
        ]
        for symbol, q in parameters.items()
    ]
    more = [LACKING] if diagnosis.unknown or diagnosis.verdict == "unknown" else []
    return origin.card(
        model=model.name, period_s=model.period_s, parameters=(*found, *diagnosis.base.parameters),
        noise=_noise_levels(model), spans=_spans(validity.range) if validity else (),
        not_for=(BEYOND_RANGE, OTHER_CAR, OFF_THE_PLANE, *more),
    )  # fmt: skip


def describe_comparison(origin: Origin, fitted: DataRange | None, validation: DataRange) -> ModelCard:
    """The card of a comparison of models: what is driven in training takes, and in the validation take.

    Where there is no training take, `fitted` is None.
    """
    spans = _spans(fitted) if fitted else ()
    return origin.card(
        spans=spans, validation_spans=_spans(validation), not_for=(BEYOND_RANGE, OTHER_CAR, OFF_THE_PLANE)
    )


def _noise_levels(model: Model) -> tuple[NoiseLevel, ...]:
    """Standard deviations of poses and of disturbances that the diagnosis fitted beside the model."""
    noise = getattr(model, "facts", {}).get("noise", {})
    rows = [*zip(POSE_NOISE, noise.get("r", ()), strict=False), *zip(DISTURBANCES, noise.get("q", ()), strict=False)]
    return tuple(NoiseLevel(name=name, value=value, unit=unit) for (name, unit), value in rows)


def _spans(data: DataRange) -> tuple[DataSpan, ...]:
    """The range of each of QUANTITIES."""
    return tuple(
        DataSpan(quantity=name, unit=unit or THROTTLE, low=low, high=high)
        for (name, unit), low, high in zip(QUANTITIES.items(), *data, strict=True)
    )

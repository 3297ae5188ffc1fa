"""A car adapted over one recording, which is ingested and estimated as the pipeline does it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bcid.adaptation.adapt import Adaptation, adapt, as_adaptable
from bcid.adaptation.quantities import release_limits, unreached_limits
from bcid.adaptation.settings import FORGET_S
from bcid.estimate.saving import load_estimate
from bcid.estimate.types import Estimate
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.saving import load_model
from bcid.pipeline.run import Pipeline
from bcid.recording.saving import load_recording


class AdaptedTake(NamedTuple):
    """A car that was adapted over a recording, the car as it was, and the recording's motion."""

    adaptation: Adaptation
    frozen: AugmentedNewtonEuler
    estimate: Estimate
    released: tuple[str, ...]  # limits of forces that the model's own drives did not reach


def adapt_over_take(
    work: Pipeline, recording: Path, model: Path, quantities: Sequence[str], forget_s: float = FORGET_S
) -> AdaptedTake:
    """Adapt the `quantities` of the car that is saved in the folder `model` over a recording.

    A car with effects of a user's own is adapted within `work.runner.own_effects_of(model)`.

    Raises:
        UsageError: the model has no constants of a car, or one of `quantities` is none of it.
        InputRefused: the recording or the model cannot be used.
    """
    work.refuse_unusable([recording])
    taken, estimated = work.ingest(recording), work.estimate(recording)
    estimate = load_estimate(estimated.folder)
    saved = load_model(model)
    car = as_adaptable(saved, work.vehicle, estimate)
    # one that is followed begins where the fit put it
    released = tuple(limit for limit in unreached_limits(saved) if limit not in quantities)
    adaptation = adapt(
        release_limits(car, released), quantities, load_recording(taken.folder), estimate, forget_s=forget_s
    )
    return AdaptedTake(adaptation, car, estimate, released)

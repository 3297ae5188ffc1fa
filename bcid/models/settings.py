"""What `[fit.MODEL]` in the pipeline file may hold, with the paper's choices as defaults."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bcid.toml_file import Settings

Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, lt=1)]
Layers = Annotated[tuple[Count, Count], Field(strict=False)]


class NoSettings(Settings):
    """Nothing to choose."""


class GeneticSettings(Settings):
    """The genetic algorithm (paper, App. parameters); generations and v_0 are ours (errata 14, 18)."""

    population: Annotated[int, Field(ge=10)] = 150
    generations: Count = 100
    v_0_mps: Annotated[float, Field(ge=0.65)] = 1.0  # RK4 at 0.05 s is unstable below


class TrainingSettings(Settings):
    """Training of a perceptron (paper, App. mlp); epochs and dropout are not printed there (errata 18)."""

    hidden: Layers = (256, 128)
    epochs: Count = 200
    batch_size: Count = 256
    learning_rate: Positive = 5e-5
    weight_decay: Annotated[float, Field(ge=0)] = 1e-5
    decay_factor: Annotated[float, Field(gt=0, le=1)] = 0.6
    decay_epochs: Count = 40
    dropout: Share = 0.02


class ResidualTrainingSettings(TrainingSettings):
    """The same with half the neurons (paper, K-SINDy-MLP)."""

    hidden: Layers = (128, 64)


class SparseSettings(Settings):
    """Sequentially thresholded least squares; the threshold is of terms scaled to unit RMS (errata 18)."""

    threshold: Annotated[float, Field(ge=0)] = 0.06
    ridge: Annotated[float, Field(ge=0)] = 1e-6
    library: Literal["vanishing", "published"] = "vanishing"  # errata 9

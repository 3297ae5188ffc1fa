"""What `[fit.MODEL]` in the pipeline file may hold, with the paper's choices as defaults."""

from typing import Annotated, Literal, get_args

from pydantic import Field

from bcid.files.toml import Settings

Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
Layers = Annotated[tuple[Count, Count], Field(strict=False)]


Loss = Literal["one-step", "rollout"]
"""What a fit minimises: predictions one period ahead, or over `horizon_s` from many starts."""

CarLoss = Literal["one-step", "rollout", "poses"]
"""A car's constants may also make the recorded poses as likely as can be: slower, and without a smoother's bias."""

LOSSES: tuple[CarLoss, ...] = get_args(CarLoss)


class NewtonEulerSettings(Settings):
    """Settings of a Newton-Euler fit (App. parameters); what the paper does not print is ours (errata)."""

    loss: CarLoss = "one-step"
    horizon_s: Positive = 2.0
    optimiser: Literal["levenberg-marquardt", "genetic"] = "levenberg-marquardt"
    starts: Count = 8
    subset: Annotated[float, Field(gt=0, le=1)] = 0.05  # of the stretches, on which starts are compared
    population: Annotated[int, Field(ge=10)] = 150
    generations: Count = 100
    v_0_mps: Annotated[float, Field(ge=0.65)] = 1.0  # RK4 at 0.05 s is unstable below


class TrainingSettings(Settings):
    """Settings of a perceptron's training (paper, App. mlp); epochs and dropout are not printed there (errata 18).

    With the loss "rollout" the epochs on single steps come first.
    """

    loss: Loss = "one-step"
    horizon_s: Positive = 2.0
    rollout_epochs: Count = 60
    rollout_learning_rate: Positive = 1e-3
    rollout_batch: Count = 32  # stretches
    hidden: Layers = (256, 128)
    epochs: Count = 200
    batch_size: Count = 256
    learning_rate: Positive = 5e-5
    weight_decay: Annotated[float, Field(ge=0)] = 1e-5
    decay_factor: Annotated[float, Field(gt=0, le=1)] = 0.6
    decay_epochs: Count = 40
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.02


class ResidualSettings(TrainingSettings):
    """Settings of K-SINDy-MLP's perceptron; a "dissipative" model gains no kinetic energy without throttle."""

    residual: Literal["plain", "dissipative"] = "plain"
    hidden: Layers = (128, 64)


class SparseSettings(Settings):
    """Settings of K-SINDy: sequentially thresholded least squares of terms scaled to unit RMS (errata 18)."""

    threshold: Annotated[float, Field(ge=0)] | None = None  # none: the one that predicts the takes' ends best
    ridge: Annotated[float, Field(ge=0)] = 1e-6
    resamples: Annotated[int, Field(ge=2)] = 50  # for the confidence in each term
    loss: Loss = "one-step"
    horizon_s: Positive = 2.0
    library: Literal["vanishing", "published"] = "vanishing"  # errata 9

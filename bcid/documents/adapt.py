"""adapt.json: how constants of a car moved while it drove, and what following them is worth."""

from typing import Literal

from pydantic import Field

from bcid.documents.document import Document, Figure, Interval, Number, Part


class AdaptedFigure(Part):
    """One quantity that was estimated while the car drove."""

    name: str
    constants: tuple[str, ...]  # on which it acts
    is_factor: bool  # on these; else the value itself
    unit: str
    first: Figure
    first_sd: Figure
    last: Figure
    last_sd: Figure
    low: Figure  # the bounds
    high: Figure


class AdaptErrors(Part):
    """Root mean squares (m) of position errors over the horizon, of predictions throughout the recording."""

    horizon_s: Figure
    predictions: int
    frozen: Number = None  # of the model as it was given; null where a prediction leaves the finite numbers
    adapted: Number = None  # of the model as it was known when each prediction began
    loss_ci95: Interval | None = None  # by how much the mean square (m^2) of those is larger; null where not known


class AdaptNoise(Part):
    """What the filter assumes."""

    push: tuple[Figure, Figure, Figure]  # on v_x, v_y (m/s/sqrt(s)) and yaw rate (rad/s/sqrt(s))
    pose_sd: tuple[Figure, Figure, Figure]  # m, m, rad
    lasting_sd: tuple[Figure, Figure, Figure]  # of what lasts of them: m/s^2, m/s^2, rad/s^2
    lasts_s: Figure
    forget_s: Figure


class AdaptDocument(Document):
    """What `bcid adapt` makes of one recording; the values over time are in adapted.csv beside it."""

    kind: Literal["bcid.adapt/1"] = Field("bcid.adapt/1", alias="schema")
    model: str
    model_digest: str
    recording: str
    period_s: Figure
    quantities: tuple[AdaptedFigure, ...]
    released: tuple[str, ...] = ()  # limits of forces that the model's drives had not reached: they are m g here
    noise: AdaptNoise
    errors: AdaptErrors
    files: tuple[str, ...]

"""The part of diagnosis.json that says what the prediction error of the base model is made of."""

from typing import Literal

from bcid.documents.document import Interval, Part

Cause = Literal["effect", "corrections", "noise", "disturbances", "unexplained", "left-noise-included"]
"""What makes a part of an error: a named effect, the base model's own simplifications, the noise of the poses,
disturbances that look random, or what none of them is; where the fitted car cannot be simulated, so that nobody knows
what noise makes, all that is left with the noise in it."""


class ErrorShare(Part):
    """One part of the error, as a share of the whole."""

    cause: Cause
    effects: tuple[str, ...] = ()  # ids of the effects that it is of; of corrections, theirs
    share: float
    ci95: Interval  # of the share, by block bootstrap


class ErrorBudget(Part):
    """The held-out squared error (NMSE) of the base model at one horizon in parts, whose shares sum to one."""

    horizon_s: float
    nmse: float  # of the base model
    parts: tuple[ErrorShare, ...]  # findings first, largest first; then corrections, noise, and what is unexplained

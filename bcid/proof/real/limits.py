"""Limits of questions to real recordings that take part in making rows: a change asks every question anew."""

from dataclasses import dataclass


@dataclass(frozen=True)
class QuestionLimits:
    """How predictions are compared, how far a model of a drive is trusted, and what counts as shown by a day."""

    # Time (s) after which the compared predictions start anew from the recorded motion.  Not yet justified.
    rmse_horizon_s: float = 1.0
    # Forward speed (m/s) below which predictions are not compared.  Not yet justified.
    min_speed_mps: float = 0.3
    # Relative standard deviation to which a model of one drive is trusted in another, or in the same drive once it is
    # edited.  Not yet justified.
    unedited_relative_sd: float = 0.02
    # Share of a day's other drives that must show an effect for it to be part of the day's simulation: issue 42.
    min_day_share: float = 0.5
    # Effects, beside those that the answer names, that are refitted in the place of what is withheld, those of the
    # greatest score first: as many as a diagnosis exchanges a name for, and one more.  Not yet justified.
    max_equivalents_tried: int = 4
    # Share of what is withheld that a name in its place may leave to be found beside it: most of it is explained then.
    max_share_left: float = 0.5
    # Time (s) after which predicted and measured positions on another drive are compared: issue 42.
    transfer_horizon_s: float = 2.0
    # Standard errors of their difference within which a size found on two drives is the same: issue 42.
    same_size_se: float = 2.0


LIMITS = QuestionLimits()

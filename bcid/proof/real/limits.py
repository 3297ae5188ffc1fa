"""Limits of questions to real recordings that take part in making rows: a change asks every question anew."""

from dataclasses import dataclass


@dataclass(frozen=True)
class QuestionLimits:
    """What is asked, and how far an unedited drive's answer is trusted."""

    # Ratio of prediction errors without and with what is withheld, above which the diagnosis is asked for it.
    # docs/results/real_dart.json: what is asked raises the error 1.5 to 15 times, what is not 1.09 times at most.
    min_error_ratio: float = 1.3
    # Time (s) after which the compared predictions start anew from the recorded motion.  Not yet justified.
    rmse_horizon_s: float = 1.0
    # Forward speed (m/s) below which predictions are not compared.  Not yet justified.
    min_speed_mps: float = 0.3
    # Relative standard deviation to which an unedited drive's parameters are trusted.  Not yet justified.
    unedited_relative_sd: float = 0.02


LIMITS = QuestionLimits()

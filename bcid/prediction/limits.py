"""Numbers that decide how a prediction is computed, and which are refused."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PredictionLimits:
    """Limits of predictions; none of the values is justified by committed figures yet."""

    # Longest prediction (s), an hour: what is longer is a mistake in the times of the commands.
    max_predicted_s: float = 3600.0
    # Pushes by which process noise is represented: one a period, until there are so many, then one every few periods.
    # The time that a covariance takes grows with their number; 200 are 20 s of the usual period of 0.1 s.
    max_pushes: int = 200
    # Difference (s) of two periods below which they count as equal.
    max_period_difference_s: float = 1e-9


LIMITS = PredictionLimits()

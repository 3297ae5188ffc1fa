"""Numbers that decide how a prediction is computed, and which are refused."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PredictionLimits:
    """Limits of predictions; none of the values is justified by committed figures yet."""

    # Longest prediction (s), an hour: what is longer is a mistake in the times of the commands.
    max_predicted_s: float = 3600.0
    # Difference (s) of two periods below which they count as equal.
    max_period_difference_s: float = 1e-9
    # Room of a parameter between its bounds, over its standard error, below which the error is not propagated.
    min_change_share: float = 1e-3


LIMITS = PredictionLimits()

"""Numbers with which a pipeline refuses a model."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PipelineLimits:
    """Which saved models fit the pipeline's grid."""

    # Difference (s) up to which two periods are the same: rounded otherwise.  Not yet justified.
    max_period_difference_s: float = 1e-9


LIMITS = PipelineLimits()

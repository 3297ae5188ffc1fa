"""Numbers with which a pipeline refuses a model, and with which it divides an error."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PipelineLimits:
    """Which saved models fit the pipeline's grid, and into how many parts an error is divided."""

    # Difference (s) up to which two periods are the same: rounded otherwise.  Not yet justified.
    max_period_difference_s: float = 1e-9
    # Findings and corrections between which a prediction error is divided.  Each more doubles the refits: six need 64
    # sets of two refits, of about 0.2 s each on a take of 300 s.
    max_budget_things: int = 6


LIMITS = PipelineLimits()

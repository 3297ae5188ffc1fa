"""Numbers with which a pipeline refuses a model, and with which it divides an error."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PipelineLimits:
    """Which saved models fit the pipeline's grid, and into how many parts an error is divided."""

    # Difference (s) up to which two periods are the same: rounded otherwise.  Not yet justified.
    max_period_difference_s: float = 1e-9
    # Findings and corrections between which a prediction error is divided; the last of more are one together.  Each
    # doubles the sets to refit, of about 0.4 s each on a take of 150 s: five take 10 s, a tenth of their diagnosis.
    max_budget_sources: int = 5


LIMITS = PipelineLimits()

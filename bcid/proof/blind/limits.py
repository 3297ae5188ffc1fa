"""Limits of the other methods on blind takes that take part in making rows: a change runs every method anew."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BaselineLimits:
    """When a method that fits the residual counts as having detected something.  Not yet justified."""

    # Share of the squares of the pushes on unseen blocks that a regression must explain.
    min_explained_share: float = 0.02
    # Smallest p-value times the number of tests (Bonferroni) below which the residual is no noise.
    residual_test_level: float = 0.01


LIMITS = BaselineLimits()

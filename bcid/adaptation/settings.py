"""What an adaptation assumes unless it is told otherwise."""

FORGET_S = 120.0
"""Time (s) after which the filter knows as little of a quantity as at first, if a drive does not show it."""

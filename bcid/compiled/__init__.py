"""The compiler (`njit`: numba with a cache keyed by imports) and vectors of numbers (`lanes`, `lane_access`)."""

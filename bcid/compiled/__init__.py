"""The compiler and its vectors.

`njit` (numba with a cache keyed by imports), `rebuild` (one text compiled more than once), `lanes` and `lane_access`
(vectors of numbers).
"""

"""The compiler and what runs in vector registers.

`njit` (numba with a cache keyed by imports), `lanes` (vectors of numbers).
"""

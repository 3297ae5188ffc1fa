"""Where a model departs from a take: by which pushes, at which place and time, in which channel, on what it depends.

`pushes` (smoothed forces on the body), `scan_statistic` (places and windows), `mismatch` (these, and what a remainder
says of channels and quantities, together).
"""

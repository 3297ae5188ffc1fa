"""Where a model departs from a take: by which pushes, at which place and time, in which channel, on what it depends.

`pushes` (smoothed forces on the body), `scan_statistic` (places and windows), `basis_functions` and `channel_gains`
(which channel), `push_directions` (which way), `regression` (on which quantities), `mismatch` (all of these together).
"""

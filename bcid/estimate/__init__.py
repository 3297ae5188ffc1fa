"""From poses and commands to twists and kinematic states: the paper's EKF and its smoother.

`run` (the estimate of a recording), over `events` (what the filter works on), `command_parts` (commands between the
grid's rows), `process` (the EKF's model), `filter_step` and `kernel` (a step, filter and smoother, compiled), which
`blockwise` runs over recordings of any length and `reference` checks by filterpy.  `tune` finds the constants of
`tuning`, and `steering` those of the steering; `consistency` checks the filter; `types` defines the result, `saving`
its files, `limits` all numbers that decide.
"""

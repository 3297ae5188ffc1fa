"""Checks of streams and recordings.

Streams: `samples` (order, times, gaps), `lost` (placeholders of poses), `attitude` (rotations, heights), `held`
(repeated poses), `interpolated` (straight lines between poses), `tracking` (jumps, ghosts, other bodies), `yaw_jumps`
and `heading` (the yaw's jumps, changes of the mounting), `pose_noise` (how finely poses are known), over `rowwise`
(reductions along rows).
Recordings: `known` (where poses and commands are), `raw_motion` (speeds from poses), `plausibility` (units and signs),
`clock` (offset of two clocks, by the whole take and by its `block_delays`), `clock_fault` (one jumps, `clock_jump`, or
drifts, `clock_drift`), `command_age` (of commands that a recorder reads at its own rate), `mounting` (yaw of the
tracked body), `contacts` (bumps and crashes), `health` (worth fitting or not).
Commands against the motion: `verdict` (what cannot be used) over `pose_verdict`, `steering_verdict`,
`throttle_verdict` and `geometry` (words of the vehicle file), on the grid of `commanded_motion`; `agreement` (what
commands explain at each lag) and `lagged_sums` (in any part of a take); `turning_terms` (what the turning is explained
by); `turning` (speed and yaw rate), by which `steering_fit` finds servo and delay of the car in `single_track`.
The numbers that decide on commands are in `limits`.
"""

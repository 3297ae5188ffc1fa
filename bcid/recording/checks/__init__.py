"""Checks of streams and recordings.

Streams: `samples` (order, times, gaps), `attitude` (rotations, heights), `tracking` (held, frozen, flipped poses).
Recordings: `raw_motion` (speeds from poses), `plausibility` (units and signs), `clock` (offset of two clocks),
`mounting` (yaw of the tracked body), `contacts` (bumps and crashes), `health` (worth fitting or not).
"""

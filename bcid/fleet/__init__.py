"""Many recordings: worked on one by one wherever there is room, and learnt from together.

`logs` finds the recordings of a fleet, and `labels` their days and cars; `tasks` is what is done to one of them, in a
process of its own, in `attempts` that may fail; `run` lets all of it be done, over `limits`, and each drive is counted
once, whatever `repeats` of it there are.

`together` is what their diagnoses say together: `occurrences` of effects, from the `log_evidence` of each, and
parameters that have `moved` from day to day.

`pooled_car` says what is the same in all recordings of a car and what is each one's own, by `pooling`, which does so
for any constants; `pool_recordings` fits the recordings, several at a time, and writes what they say.
"""

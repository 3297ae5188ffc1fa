"""Many recordings: worked on one by one wherever there is room, and learnt from together.

`logs` finds the recordings of a fleet; `tasks` is what is done to one of them, in a process of its own; `run` lets all
of it be done, over `limits`.

`pooled_car` says what is the same in all recordings of a car and what is each one's own, by `pooling`, which does so
for any constants; `pool_recordings` reads the recordings one after the other, and writes what they say.
"""

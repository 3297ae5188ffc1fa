"""Many recordings: worked on one by one wherever there is room, and learnt from together.

`logs` finds the recordings of a fleet; `tasks` is what is done to one of them, in a process of its own; `run` lets all
of it be done, over `limits`.  `pooling` says what recordings of one car say together.
"""

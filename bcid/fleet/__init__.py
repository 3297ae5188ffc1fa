"""Many recordings: worked on one by one wherever there is room, and learnt from together.

`pooling` says what recordings of one car say together.
"""

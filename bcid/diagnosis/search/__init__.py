"""Which effects of the vocabulary explain a take.

`trials` (columns to test), `screen` (score tests), `line_search` (sizes), `place_search` (places), `refits` (joint
refits of candidates), `rivals` (what explains as much), `forward_backward` (the search itself).
"""

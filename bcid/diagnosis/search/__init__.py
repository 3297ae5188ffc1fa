"""The search for the effects of the vocabulary that explain a take.

`screen` (score tests of trials), `refits` (joint refits of candidates), `line_search` (sizes), `place_search` (places),
`rivals` (what explains as much), `forward_backward` (the search itself).
"""

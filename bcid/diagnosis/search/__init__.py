"""The search for the effects of the vocabulary that explain a take.

`name_search` (the search itself, beside a remainder), `name_scores` (what effects promise beside it), `screen` (score
tests of trials), `refits` (joint refits of candidates), `corrections` (of the base model's own simplifications),
`place_search` (places), `rivals` (what explains as much).
"""

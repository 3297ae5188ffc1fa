"""The search for the effects of the vocabulary that explain a take.

`name_search` (the search itself), `add_names` (one name after the other, without a remainder and beside one),
`keep_names` (which of them stay), `search_state` (what was found so far), `name_scores` (what effects promise beside a
remainder), `screen` (score tests of trials), `refits` (joint refits of candidates), `corrections` (of the base model's
own simplifications), `place_search` (places), `rivals` (what explains as much).
"""

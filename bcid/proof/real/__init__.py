"""Questions to real recordings: a published model without one of its effects, controls, and edits of known size.

`questions` (as a file asks them), `run_questions` (all of them), `withheld` (effects taken from a model), `edited` (an
effect made in a recording, by `edits`), `question_files` (what a diagnosis is given), `scoring` (right or not),
`limits` (of rows).
"""

"""Questions to real recordings: a day's simulation without one of its effects, controls, edits, and pairs of drives.

Asked: `questions` (as a file asks them), `variations` (from another start, of a part of the drive), `question_files`
(what a diagnosis is given).  Answered: `day_model` (the simulation of a day), `withheld` (an effect taken from it, or
none), `oracle` (what that is worth, and what cannot be told from it), `misfit` (how far the simulation is off),
`edited` (an effect made in a recording, by `edits`), `replication` (two drives of one day), `transfer` (predictions of
another drive, by `residual_model` among others).  Run: `jobs` (what is to be done), `run_questions` (all of it).
Counted: `scoring` (right or not), `figures`.  `limits` decides what is in rows.
"""

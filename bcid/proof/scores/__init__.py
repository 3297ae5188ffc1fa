"""Figures of a blind test, from its rows.

`outcome` (prove.json), from `tiers` (right answers), `localisation` (channels, places, times), `calibration`
(probabilities) and `compare_methods` (other methods).  `limit_changes` (limits.json)
counts verdicts that hang on a limit.
"""

"""What physics a recording shows that a model lacks: located, named, modelled.

Every hypothesis is a car with effects, refitted to the recording (`bcid.likelihood`).  `diagnose` holds the steps:
`remainder` says what free functions explain beside a fit, `locate` where the base model departs from the take, `search`
finds the effects that explain it, and `judge` says which of them are named.  `reference_model` is a simulation that a
recording is compared with, `reference` reads one, `summary` writes a diagnosis as its document, `base_parameters` the
car in it, `limits` holds all numbers that decide, and `kept_steps` lets the proof that varies them use steps again.
"""

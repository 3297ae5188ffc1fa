"""What physics a recording shows that a model lacks: located, named, modelled.

Every hypothesis is a car with effects, refitted to the recording (`bcid.likelihood`).
"""

"""Predictions of pose and twist with their covariance, from a state or from a moment of a recording.

`fitted_model` (a saved model that predicts) over `prediction` (what is predicted) and its `covariance`, which comes
from the `start` (what is known of the vehicle before), from the `constants` (how well they are known) and from the
model's process noise; `motion` (a vehicle under way, advanced step by step), `commands` (what is driven), `table`
(columns of CSV and Parquet), `limits` (all numbers that decide).
"""

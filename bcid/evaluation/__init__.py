"""Fitted models compared, closed loop, with takes that they have not seen.

`evaluate` (the scores of a model), from `closed_loop` (rollouts and their errors); `error_budget` (the parts of an
error); `process_noise` (what explains the errors), `intervals` (of predictions, sampled from this noise),
`noise_covariance` (of pose and twist, linearised), `validity` (process noise and range of the training data, saved
beside a model), `residuals` (whether a model lacks physics, by its own takes), `seen_takes` (which takes these were),
`parameter_differences` (whether constants of two fits differ by more than chance), `drag_at_one_speed` (where their
drag can be compared), `limits` (all numbers that decide).
"""

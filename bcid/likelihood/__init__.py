"""How likely a car with some effects makes recorded poses, and the fit that makes them likeliest.

Multi-step output errors: short segments of poses (`take`), each with a free initial state, predicted (`predict`, by
`lane_rollout` from `prediction_inputs`) under random pushes of unknown size, which are eliminated (`marginal`,
`nuisance`).  A `hypothesis` is fitted by `prepare` (base model) and `refit` (with effects), by `newton` steps, under
pushes as `refit_with_pushes` says; `score_test` says what an effect more would gain, by the changes of poses that
`projection` finds no fit to imitate, `divergence` what becomes of predictions that diverge; `limits` holds all numbers
that decide.
"""

"""How likely a car with some effects makes recorded poses, and the fit that makes them likeliest.

Multi-step output errors: short segments of poses (`take`), each with a free initial state, predicted from the commands
through the deterministic actuator chain under random pushes of unknown size (`lane_rollout`, `predict`), which are
eliminated (`marginal`, `nuisance`).  `prepare` and `refit` fit base parameters and effects (`hypothesis`) jointly,
`score_test` says what an effect more would gain, `limits` holds all numbers that decide.
"""

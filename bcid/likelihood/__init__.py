"""How likely a car with some effects makes recorded poses, and the fit that makes them likeliest.

Multi-step output errors: short segments of poses (`take`), each with a free initial state, predicted (`predict`, by
`lane_rollout` and `observe` from `prediction_inputs`) under random pushes of unknown size, which are eliminated
(`marginal`, `nuisance`).  Derivatives go along with a prediction (`linearised_rollout`) by the variational equation
(`variational` at a stage, `step_matrix` over a step); `jacobian` has those by a hypothesis's parameters,
`force_history` those by any history of forces, `tracking_functions` those by what the tracking does without a name.
A `hypothesis` is fitted by `prepare` (base model) and `refit` (with effects), by `newton` steps, under pushes as
`refit_with_pushes` says; `score_test` says what an effect more would gain, by the changes of poses that `projection`
finds no fit to imitate, `divergence` what becomes of predictions that diverge; `limits` holds all numbers that decide.
"""

"""How likely a car with some effects makes recorded poses, and the fit that makes them likeliest.

Multi-step output errors: short segments of poses (`take`), each with a free initial state, predicted (`predict`, by
`lane_rollout` from `lane_start` on, `observe` and `tracking_functions`, from `prediction_inputs`) under random pushes
of unknown size, which are eliminated (`marginal`, by `triangles`, and `nuisance`); their size and the noise's, the
`scales`, are found by `scale_estimate`.  Derivatives go along with a prediction
(`linearised_rollout`) by the variational equation: `variational` at a stage, with `lag_derivatives` and
`remainder_derivatives`, and `step_matrix` over a step meet in `step_derivatives`; `jacobian` has those by a
hypothesis's parameters, `force_history` those by all that may act on the car.
A `hypothesis`, with a `prior` and `unnamed_functions`, is fitted by `base_fit` (base model, which `prepare` begins) and
`refit` (with effects), by `newton` steps from one `refit_state` to the next, at each of which initial states find their
places (`settling`, by `tangent_steps` of some `state_segments`) and go along with parameters (`following`);
`linearised_segments` compares many hypotheses quickly; `score_test` says what an effect more would
gain, by the changes of poses that `projection` finds no fit to imitate, `without_prior` what a take alone says of
parameters, `divergence` what becomes of predictions that diverge, `price` what a parameter costs; `kept_fits` lets a
proof use refits again; `limits` holds all numbers that decide.
"""

"""How parameters are fitted, whatever the model.

`windows` (samples cut from takes), `genetic` and `levenberg_marquardt` (two optimisers), `optimum` (what they return),
`block_covariance` (the covariance of a fit with correlated residuals).
"""

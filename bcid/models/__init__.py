"""Vehicle models that predict the twist from commands.

`table` lists them, `interface` is what all have in common, `settings` what a pipeline file may say of their fits,
`saving` their files, `saved_parts` what these must hold, `fitting` the optimisers and samples.  The models:
`newton_euler` (rigid body with tyres), `kinematic` (evolution of the kinematic state), `network` (perceptrons),
`published` (the paper's own numbers).  `limits` holds all numbers that decide.
"""

"""What physics a recording shows that a model lacks: located, named, modelled.

The likelihood is that of multi-step output errors: short segments of measured poses, each with a free
initial state, driven by the commands through the whole deterministic actuator chain, with random forces
of unknown size on the body (`segments`, `marginal`); every hypothesis refits the base parameters with
its own (`refit`).
"""

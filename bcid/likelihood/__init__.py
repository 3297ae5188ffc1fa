"""How likely a car with some effects makes recorded poses.

Multi-step output errors: short segments of measured poses, each with a free initial state, driven by the commands
through the whole deterministic actuator chain, with random forces of unknown size on the body (`segments`,
`marginal`); the base parameters and those of the effects are refitted together (`refit`).
"""

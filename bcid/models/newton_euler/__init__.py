"""Newton-Euler models of the twist: fitted constants, their linearisation, and the car augmented by effects."""

CARS_PER_CHUNK = 256
"""Cars whose states advance together: few enough for them to stay in the nearest cache."""

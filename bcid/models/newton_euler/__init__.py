"""Newton-Euler models of the twist.

Equations with fitted constants, their linearisation, and those augmented by effects.
"""

"""How models are fitted, whatever they are.

Windows of samples, Levenberg-Marquardt, a genetic algorithm, covariance over blocks.
"""

"""Perceptrons: how they are trained (torch) and run (compiled), and the autoregressive NARX-MLP."""

"""Perceptrons: how they are trained and run, and the autoregressive NARX-MLP.

`training` (in torch), `mlp` (the compiled perceptron), `sparse_product` (its product with an input that is mostly
zero), `narx_mlp` (the model).
"""

"""Figures of a blind test: right answers by tier, places and channels, intervals and probabilities, other methods."""

"""The figures of a blind test: right answers by tier, places and channels, intervals and stated probabilities."""

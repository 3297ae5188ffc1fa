"""What a model leaves unexplained as a hypothesis of its own: free smooth functions in every channel.

`functions` (which there are), `information` (what a take says of them), `evidence` (how large they may be, and what
that explains), `waves` (fine ones, by a periodogram), `fit` (a refit with them), `scores` (what a name adds beside
them).
"""

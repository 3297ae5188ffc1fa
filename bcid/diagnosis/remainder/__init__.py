"""What a model leaves unexplained as a hypothesis of its own: free smooth functions in every channel.

`functions` (which there are), `evidence` (how large they may be, and what that explains), `fit` (a refit with them).
"""

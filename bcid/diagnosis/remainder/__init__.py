"""What a model leaves unexplained as a hypothesis of its own: free smooth functions in every channel.

`functions` (which there are), `waves` (fine ones), `information` (what a take says of them), `evidence` (how large they
may be, and what that adds), `explain` (what they explain to first order), `chance` (what they explain by chance), `fit`
(a refit with them), `curve` (the missing law that they show), `beside_names` (functions beside a car that is held, for
predictions).
"""

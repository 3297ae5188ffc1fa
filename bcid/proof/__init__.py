"""Proof: does a diagnosis find what a simulation conceals, or what a real drive is known to lack?

The only package that knows both the simulation and the diagnosis; a diagnosis is given recordings and a vehicle
file, never a case or a question.

`blind`   simulated takes with concealed effects, sealed answers, and other methods on the same takes
`real`    questions to real recordings: a day's model without one effect, controls, edits, pairs of drives
`scores`  figures of a blind test: right answers by tier, places, probabilities, other methods
`rows`    what is kept of a diagnosis, and the file that rows are stored in
`limits`  goals of the tiers, and what counts as right
"""

"""What to drive so that given effects show, or can be told apart.

`patterns` (commands over time) make `manoeuvres` (drives that fit an arena), which `simulate` predicts under a fit;
`detectability` is the smallest size of an effect that a drive shows, `discrimination` what two rival fits differ by on
it, `plan` the choice of drives, `limits` all numbers that decide.
"""

"""The blind test: takes that conceal effects, sealed answers, their diagnoses, and other methods on the same takes.

`blind_test` (from end to end), `cases` (a suite, drawn from a seed), `concealed_effects` (what they conceal), `seal`
(of their answers), `run_cases` (all of them), `diagnose_case` (one), `baselines` (other methods), `limits` (of these).
"""

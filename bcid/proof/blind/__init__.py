"""The blind test: takes that conceal effects, sealed answers, their diagnoses, and other methods on the same takes.

`blind_test` (from end to end), `cases` (a suite, drawn from a seed), `blind_case` (one take and its answer),
`concealed_effects` (what they conceal), `seal` (of their answers), `run_cases` (all of them), `diagnose_case` (one),
`baselines` (other methods), `regressors` (what they regress on), `limits` (of these).  Limits of the diagnosis halved
and doubled: `limit_panel` (takes), `varied_take` (one of them), `vary_limits` (all).  Of small cars: `small_suite`
(their tiers), `small_case` (one take), `small_effects` (what they conceal), `small_files` (their vehicle file and
published simulation); of those that are other than published: `other_suite` (their tiers), `published_case` (one take),
`nearest_figures` (what an author publishes of a car of other formulas).  Of tricycles: `tricycle_suite` (their tier and
what it conceals), `tricycle_case` (one take).
"""

"""Does a diagnosis find what a simulation conceals, or what a real drive is known to lack?

The only place that knows both the simulation and the diagnosis; the diagnosis is handed a recording and a
vehicle file, never a case.

Concealed takes: `blind` (the whole of it), `cases`, `concealed` (what and how large), `running`, `asking` (one take),
`seal`; `scoring`, `localisation`, `calibration`, `outcome` (figures); `baselines`, `methods` (others on these takes).
Real drives: `real` (the whole of it), `real_cases` (questions), `asked` (files), `withheld`, `edits`, `edited`
(answers); `real_scoring`, `real_outcome` (figures).  Both: `said` (what is kept of a diagnosis), `keeping`, `workers`.
"""

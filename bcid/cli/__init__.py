"""The command line: thin commands over the pipeline, one place for output, one table of errors.

`app` (the commands), of which `starting` (the first files), `checking` (health of recordings), `fitting` (models and
their scores), `reporting` (the comparison, and everything at once), `diagnosing` (missing physics), `comparing` (two
runs), `pooling` (recordings together), `fleets` (any number of logs), `listing` (models and effects), `proving` (how
often missing physics is found), `simulating` (simulated drives; `driving`, of saved models), `predicting` (pose and
twist with intervals), `adapting` (constants while it drives), `exporting` (models as code), `viewing` (takes to look
at) and `benching` (benchmarks) hold some; `options` (which several share), `completion` (of words by the shell),
`examples` (at the end of each help), `sink` (where output goes), `progress` (how far a stage is), `exits` (from errors
to messages and exit codes), `show` and `show_fits` (results as tables), `limits` (all numbers that decide).
"""

"""The command line: thin commands over the pipeline, one place for output, one table of errors.

`app` (the commands), of which `starting` (the first files), `checking` (health of recordings), `diagnosing` (missing
physics), `listing` (models and effects), `proving` (how often missing physics is found), `simulating` (simulated
drives; `driving`, of saved models), `predicting` (pose and twist with intervals), `exporting` (models as code) and
`benching` (benchmarks) hold some; `options` (which several share), `sink` (where output goes), `exits` (from errors to
messages and exit codes), `show` (results as tables), `limits` (all numbers that decide).
"""

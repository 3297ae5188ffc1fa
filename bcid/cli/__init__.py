"""The command line: thin commands over the pipeline, one place for output, one table of errors.

`app` (the commands), of which `diagnosing` (missing physics), `benching` (benchmarks), `checking` (health of
recordings) and `driving` (simulated drives) hold some; `options` (which several share), `sink` (where output goes),
`show` (results as tables), `limits` (all numbers that decide).
"""

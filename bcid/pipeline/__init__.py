"""From a pipeline file to artifacts: the stages, what each depends on, and what is reused.

`config` (the pipeline file), `run` (stages run or reused), `stages` (what each does), `watching` (who follows them as
they run), `publishing` (copies of results where people look for them), `takes` (which take is which),
`single_take` (the motion of one recording), `limits` (all numbers that decide).
"""

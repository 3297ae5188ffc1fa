"""From a pipeline file to artifacts: the stages, what each depends on, and what is reused.

`config` (the pipeline file), `run` (stages run or reused), `stages` (what each does), `watching` (who follows them as
they run), `progress` (of a diagnosis), `publishing` (copies of results where people look for them), `named_models`
(saved models by name), `takes` (which take is which), `single_take` (the motion of one recording), `cuts` (parts of
takes), `tidy_tables` and `partitioned_tables` (takes for other programs), `compare_runs` (is it the same car?),
`error_budget` (what a diagnosis's error is made of), `model_card` (where a result comes from), `limits` (all numbers
that decide).
"""

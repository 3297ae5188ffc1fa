"""From a pipeline file to artifacts: the stages, what each depends on, and what is reused.

What is made: `config` (the pipeline file), `run` (all that can be made of it), over the stages by their subject:
`take_stages` (ingest, tune, estimate, check), `model_stages` (fit, evaluate), `diagnosis_stages` (diagnosis and page)
and `report_stage` (the comparison); each says what its stages depend on, `stage_runner` runs or reuses one, and
`stages` holds what each does.

Beside these: `watching` (who follows stages as they run), `progress` (of a diagnosis), `publishing` (copies of results
where people look for them), `named_models` (saved models by name), `takes` (which take is which),
`single_take` (the motion of one recording), `adapted_take` (a car adapted over one), `tidy_tables` and
`partitioned_tables` (takes for other programs), `compare_runs` (is it the same car?) by `read_run` (what a run says of
its cars), `error_budget` (what a diagnosis's error is made of), `origin`, `making_date` and `model_card` (where and
when a result comes from), `limits` (all numbers that decide).
"""

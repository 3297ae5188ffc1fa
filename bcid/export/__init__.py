"""Saved models as code for controllers, simulators and twins: no law is written a second time, each file is run first.

A model becomes formulas: `graph` (what they are), `trace` (compiled functions run over nodes of a graph), `formulas` (a
period of a model), `model_formulas`, `augmented_formulas` and `pose_formulas` (of each kind of model, of poses).
`derivatives` (their slopes), `substitution` (constants made inputs) and `tape` (formulas run here) are for filters.

Formulas become files: `statements` (lines of a program in any language), `c_source`, `python_source` and
`casadi_source` (with `python_text`, what the two have in common), `onnx_graph` and `onnx_rollout`, `fmi`,
`framework_files` (acados, ROS 2), `parameter_file` (other simulators' constants).

Files are checked and written: `reference_drive` (what the model makes of 200 commands), `reference_steps` (of single
periods), `start` (where slip angles start), `check_programs` and `check` (an export run beside it), `exported` (what is
exported, with `names` and `commands`: what it may be called, what its commands mean), `formats` (the table of them),
`write`.
"""

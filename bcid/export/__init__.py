"""Saved models as code for controllers, simulators and twins: no law is written a second time, each file is run first.

graph              formulas as graphs
trace              compiled functions run over nodes of a graph
formulas           one period of a model as formulas; model_formulas, augmented_formulas: of each kind of model
statements         formulas as the lines of a program in some language
c_source, python_source, casadi_source    programs in C, Python, CasADi; python_text: what the latter two have in common
framework_files, parameter_file           files for acados, ROS 2, CommonRoad and the F1TENTH gym
fmi                co-simulation: the C in FMUs
onnx_graph, onnx_rollout                  a step and a rollout in ONNX
reference_drive    what a model makes of 200 commands; check_programs, check: every export compared with it
exported, formats, write                  what is exported, the table of formats, the files
"""

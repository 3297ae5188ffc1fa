"""A fitted car that learns on line: a few of its constants are estimated while it drives.

`adapt` runs it over a recording, `on_line` goes on from there pose by pose, and `recovery` compares it with the model
as it was; below them are `filter`, the extended Kalman filter, with `filter_run`, its loops, and `formulas`, what these
need of a car: its step, its slopes and its tracked pose.  `quantities` says what can be adapted, `settings` what is
assumed unless told otherwise, `write` what is written of an adaptation; `c_source` is the same filter in C, `c_test`
its test.
"""

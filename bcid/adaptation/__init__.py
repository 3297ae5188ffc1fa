"""A fitted car that learns on line: a few of its constants are estimated while it drives.

`adapt` runs it over a recording and compares it with the model as it was, over `filter`, the extended Kalman filter, and
`formulas`, what that needs of a car: its step, its slopes and its tracked pose.  `quantities` says what can be adapted,
`c_source` writes the same filter in C.
"""

"""Does a diagnosis find what a simulation conceals?  Cases with known answers, run and scored.

The only place that knows both the simulation and the diagnosis; the diagnosis is handed a recording and a
vehicle file, never a case.
"""

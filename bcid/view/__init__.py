"""A take, or a diagnosis of it, as one MCAP file to look at in Foxglove or PlotJuggler; results as CSV and LaTeX.

What is shown: `content` (a take, its predictions and its diagnosis), from a recording (`from_take`, with `stamps`, the
times in its file) or from a workspace (`from_workspace`).  How it is drawn: `scene` (shapes in space), `findings`
(what was found, told where it matters), `topics` (the messages of every topic, in order), made of `messages`, whose
JSON is defined in `schemas`.  What is written: `write_view` (the MCAP file), `layout` (the panels that show it),
`vehicle_file` (by which bcid reads it back).  Tables: `tables` (the results, cell by cell), `latex`, `write_tables`.
"""

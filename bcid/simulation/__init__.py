"""A car to make logs with.  It shares no code with the models that explain them (import-linter guards it).

`car` (its constants), `dynamics` (the plant), `driver` (who keeps it in the arena), `drive` (a drive as it is
recorded), `open_loop` (one under commands given beforehand), `writing` (its files), `samples` (the drives of
`sample_logs/`).
"""

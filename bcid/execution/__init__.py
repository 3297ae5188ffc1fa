"""Where work is done: in this process, in several of this machine, or on a Dask cluster, by the same call.

`jobs` runs jobs and gives their results as they end, over `pool`, the processes of this machine, and `cluster`, those
of others; `limits` says how often a job is tried.
"""

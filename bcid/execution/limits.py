"""Numbers that decide when a job, a process or a cluster is given up."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ExecutionLimits:
    """Limits of running jobs."""

    # Processes that may die of a job until it is given up: one is a machine that ran out of memory or a worker that
    # was stopped, three are the job.  A Dask cluster counts for itself, and names a job when one too many has died.
    max_deaths: int = 3
    # Seconds from asking a process to end until it is killed.
    end_within_s: float = 2.0
    # Seconds until a Dask scheduler that does not answer, or has no worker, is given up.
    connect_within_s: float = 5.0
    # Seconds between looks whether a cluster whose calls take long still has workers.
    look_every_s: float = 5.0
    # Seconds that calls wait for a cluster without workers: a nanny starts a dead one anew within some seconds.
    without_workers_s: float = 60.0


LIMITS = ExecutionLimits()

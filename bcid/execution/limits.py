"""Numbers that decide when a job is given up."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ExecutionLimits:
    """Limits of running jobs."""

    # Times that a job may lose its process before it is given up: once is a machine that ran out of memory or a worker
    # that was stopped, three times is the job.
    max_deaths: int = 3
    # Seconds from asking a process to end until it is killed.
    end_within_s: float = 2.0


LIMITS = ExecutionLimits()

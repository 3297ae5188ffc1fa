"""Numbers with which the commands refuse an option, warn of a long run, or end an interrupted one."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CommandLimits:
    """Simulated drives that `bcid simulate` makes, blind tests that `bcid prove` calls long, and interruptions."""

    # Shortest simulated drive (s).  Not yet justified.
    min_drive_s: float = 1.0
    # Longest simulated drive (s).  Not yet justified.
    max_drive_s: float = 7200.0
    # Lowest rate (Hz) of a simulated drive's poses.  Not yet justified.
    min_rate_hz: float = 5.0
    # Highest rate (Hz) of a simulated drive's poses.  Not yet justified.
    max_rate_hz: float = 240.0
    # Takes of a blind test above which a note says that it needs hours: docs/results/prove.json has 14 s for each.
    max_quiet_takes: int = 100

    # Time (s) after which an interruption that came while the compiler was at work is tried again: a person waits
    # that long without noticing, and most of the compiler's steps are over.  Not yet justified further.
    interrupt_retry_s: float = 0.05


LIMITS = CommandLimits()

"""Numbers with which the commands refuse an option, or warn of a long run."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CommandLimits:
    """Simulated drives that `bcid simulate` makes, and blind tests that `bcid prove` calls long."""

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


LIMITS = CommandLimits()

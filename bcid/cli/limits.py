"""Numbers with which commands refuse an option, warn of a long run, end an interrupted one, or say how far it is."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CommandLimits:
    """Drives that `bcid simulate` makes, blind tests that `bcid prove` calls long, interruptions, lines of progress."""

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

    # Share of a stage below which nobody can say from its time so far how long the rest takes: what a stage begins
    # with (compiling, reading) is seldom like what follows.  Not yet justified further.
    min_share_to_extrapolate: float = 0.1
    # Time (s) between two lines of progress where stderr is no terminal, at least: a stage that is over sooner prints
    # none, and the log of a run of an hour stays readable.
    min_line_gap_s: float = 5.0
    # Time (s) after which such a line is printed though no tenth of the work was finished: a person who waits wonders
    # after half a minute whether anything happens.
    line_every_s: float = 30.0


LIMITS = CommandLimits()

"""Numbers of a fleet: how far it is."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FleetLimits:
    """Limits of how the progress of a fleet is told."""

    # Share of the work on a log that its evaluation takes, as progress counts it: predicting one take takes a second
    # where fitting takes ten and a diagnosis minutes.  Only the time that is said to be left depends on it.
    evaluation_share: float = 0.05


LIMITS = FleetLimits()

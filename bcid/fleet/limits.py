"""Numbers of a fleet: how far it is, and when its logs together show something."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FleetLimits:
    """Limits of how the progress of a fleet is told, and of what its logs together show."""

    # Share of the work on a log that its evaluation takes, as progress counts it: predicting one take takes a second
    # where fitting takes ten and a diagnosis minutes.  Only the time that is said to be left depends on it.
    evaluation_share: float = 0.05

    # Share of logs whose diagnosis is wrong, whatever it says, so that a log alone counts 4.6 nats at most.  Of fleets
    # whose logs name a wrong effect in one of fifty, and miss one as often, what is told is as likely as it is said
    # (tests/test_fleet_diagnosis.py); in the blind test false alarms are rarer (docs/results/prove.json).
    wrong_log_rate: float = 0.01

    # Expected share of false ones among the effects, and among the changes of parameters, that are told of a fleet.
    false_share: float = 0.05

    # Relative standard error above which a parameter is not compared by its logarithm.
    most_relative_se: float = 0.3

    # Nats by which effects must differ to be told apart, as in the diagnosis of one log (JUDGE_LIMITS.rival_nats).
    twin_nats: float = 4.0


LIMITS = FleetLimits()

"""fleet.json: what came of each log of a fleet, which artifacts are kept of it, and why a part of it failed."""

from typing import Literal

from pydantic import Field

from bcid.documents.diagnosis import Verdict
from bcid.documents.document import Document, Interval, Number, Part

LogState = Literal["done", "partly", "failed"]
"""Whether all of a log's stages are done; some of them, a fit or a diagnosis among them; or none of these."""


PRESENT = 0.5
"""Probability above which a log counts as one that has an effect."""


class KeptArtifact(Part):
    """An artifact that is kept of a log: the folder WORKSPACE/`stage`/`key`."""

    stage: str
    key: str
    model: str = ""  # that was fitted or evaluated


class LogProblem(Part):
    """Why a stage of a log failed."""

    stage: str
    error: str  # its kind, such as InputRefused
    text: str  # cause and next step


class LogScore(Part):
    """The closed-loop error (NMSE) of a model that was fitted to one log, on another log that it has not seen."""

    model: str
    on: str  # name of the other log
    nmse: Number = None
    nmse_ci95: Interval | None = None


class LogVerdict(Part):
    """What the diagnosis of a log says, in short."""

    verdict: Verdict
    effects: tuple[str, ...] = ()
    sentence: str = ""


class FleetLog(Part):
    """One log: how far it came, its key figures, the artifacts that are kept of it, and what went wrong."""

    name: str
    file: str
    state: LogState
    day: str = ""  # on which it was driven; "" where that is not known
    car: str = ""  # that drove; "" where that is not known
    same_drive_as: str = ""  # the first log of the same drive, which counts for both; "" where there is none before it
    duration_s: Number = None
    go: bool | None = None  # whether its check says that it is worth fitting; null where it cannot be read
    artifacts: tuple[KeptArtifact, ...] = ()
    scores: tuple[LogScore, ...] = ()
    diagnosis: LogVerdict | None = None
    problems: tuple[LogProblem, ...] = ()
    notes: tuple[str, ...] = ()  # what a person should know, such as an artifact that was edited and set aside

    def has(self, stage: str) -> bool:
        """Whether an artifact of this stage is kept."""
        return bool(self.keys_of(stage))

    def keys_of(self, stage: str) -> list[str]:
        """The keys of the artifacts of this stage that are kept."""
        return [artifact.key for artifact in self.artifacts if artifact.stage == stage]


class FleetEffect(Part):
    """An effect that the logs of a fleet show together: since which day, in what share of them, in which."""

    effect: str
    probability: float  # that the fleet has it
    evidence_nats: float
    twins: tuple[str, ...] = ()  # effects that explain the logs nearly as well
    since: str  # the day since which it is likeliest to be there
    since_probability: float
    share: float  # of the cars that have it since then; of the logs, where it is not known which car drove
    share_ci90: Interval
    in_logs: dict[str, float]  # the probability that each log has it, of those that can say
    in_cars: dict[str, float]  # that each car has it in its last log; empty where it is not known which car drove


class LogValue(Part):
    """A parameter as one log shows it."""

    log: str
    day: str
    value: float
    se: float


class DayValue(Part):
    """The mean of a parameter over the logs of a day, or the cars."""

    day: str
    mean: float
    ci95: Interval


class MovedParameter(Part):
    """A parameter that is another on a later day than on the first."""

    symbol: str
    day: str
    beside: str  # the first day on which it is known
    change: float  # a share of the value, or in its unit where it may have either sign
    se: float
    interval: Interval  # such that 95 % of those hold that are reported
    relative: bool
    unit: str = ""
    p_value: float  # of no change


class FleetParameter(Part):
    """A parameter of the car, or of an effect that was found, over the logs of a fleet."""

    symbol: str
    unit: str = ""
    scatter: Number = None  # from log to log of a day, beside standard errors: a share, or in its unit as changes are
    logs: tuple[LogValue, ...]
    days: tuple[DayValue, ...] = ()


class FleetDiagnosis(Part):
    """What the diagnoses of all logs say together."""

    days: tuple[str, ...]  # with diagnosed logs, in their order
    without: tuple[str, ...] = ()  # days of which no log was diagnosed
    effects: tuple[FleetEffect, ...] = ()
    moved: tuple[MovedParameter, ...] = ()  # the most certain first
    parameters: tuple[FleetParameter, ...] = ()
    left_out: tuple[str, ...] = ()  # logs whose parameters do not count: they have an effect that they do not name


class FleetDocument(Document):
    """All logs of a fleet, in the order in which they were named (`bcid.fleet/1`)."""

    kind: Literal["bcid.fleet/1"] = Field("bcid.fleet/1", alias="schema")
    vehicle: str
    models: tuple[str, ...]
    diagnosed: bool  # whether each log was to be diagnosed
    logs: tuple[FleetLog, ...]
    together: FleetDiagnosis | None = None  # null where fewer than two logs were diagnosed, or it failed
    problems: tuple[LogProblem, ...] = ()  # why it failed

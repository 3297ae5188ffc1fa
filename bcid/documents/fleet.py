"""fleet.json: what came of each log of a fleet, which artifacts are kept of it, and why a part of it failed."""

from typing import Literal

from pydantic import Field

from bcid.documents.diagnosis import Verdict
from bcid.documents.document import Document, Interval, Number, Part

LogState = Literal["done", "partly", "failed"]
"""Whether all of a log's stages are done; some of them, a fit or a diagnosis among them; or none of these."""


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
    duration_s: Number = None
    go: bool | None = None  # whether its check says that it is worth fitting; null where it cannot be read
    artifacts: tuple[KeptArtifact, ...] = ()
    scores: tuple[LogScore, ...] = ()
    diagnosis: LogVerdict | None = None
    problems: tuple[LogProblem, ...] = ()

    def has(self, stage: str) -> bool:
        """Whether an artifact of this stage is kept."""
        return any(artifact.stage == stage for artifact in self.artifacts)


class FleetDocument(Document):
    """All logs of a fleet, in the order in which they were named (`bcid.fleet/1`)."""

    kind: Literal["bcid.fleet/1"] = Field("bcid.fleet/1", alias="schema")
    vehicle: str
    models: tuple[str, ...]
    diagnosed: bool  # whether each log was to be diagnosed
    logs: tuple[FleetLog, ...]

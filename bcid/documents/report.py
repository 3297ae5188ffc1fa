"""report.json: how well each fitted model predicts a take that none has seen; and evaluation.json, one model's part."""

from typing import Literal

from pydantic import Field

from bcid.documents.document import Document, Interval, NotNegative, Number, Part


class ProcessNoiseFigures(Part):
    """The process noise of a fitted model."""

    # root spectral density of each component of the twist, per root second
    q: tuple[NotNegative, NotNegative, NotNegative]
    tau_s: NotNegative  # time over which the noise stays alike; 0 for one step
    factor: NotNegative  # by which the intervals are widened for what is not normally distributed
    pose_factor: NotNegative | None = None  # by which those of a pose are, which adds up the twist's errors


class Coverage(Part):
    """Share of twists within the model's 95 % intervals one horizon after a start, and that share's own interval."""

    horizon_s: float
    covered: float
    ci95: Interval
    starts: int


class ModelScore(Part):
    """One model's closed-loop error (NMSE) on the validation take; null where its prediction diverges."""

    model: str
    saw_validation: bool | None = None  # whether it was made from the validation take; null where nobody knows
    nmse: Number = None
    nmse_ci95: Interval | None = None
    nmse_vx: Number = None
    nmse_vy: Number = None
    nmse_yaw_rate: Number = None
    nmse_restarted: Number = None  # predictions started anew every `restart_s`
    end_miss_m: Number = None  # median distance from the measured place at the end of such a prediction
    rollout_ms: Number = None
    parameters: int
    process_noise: ProcessNoiseFigures | None = None
    coverage: tuple[Coverage, ...] | None = None
    take_outside_range: Number = None  # share of the take outside the range of the training data
    beyond: tuple[str, ...] | None = None  # where the rollout leaves that range, in words


class EvaluationDocument(ModelScore, Document):
    """evaluation.json: the score of one model, the weights of its NMSE and its equations with their fitted values."""

    weights: tuple[float, float, float]  # of v_x, v_y (s/m) and yaw rate (s/rad)
    description: str


class LossScore(Part):
    """The error of a model fitted by one of the losses that are compared."""

    model: str
    loss: str
    nmse: Number = None
    nmse_ci95: Interval | None = None
    nmse_restarted: Number = None


class Validation(Part):
    """The take that the models are compared on."""

    name: str
    duration_s: float
    period_s: float
    samples: int
    segments: int


class Weights(Part):
    """The weights of the NMSE: one over the standard deviations of the training takes."""

    v_x: float
    v_y: float
    yaw_rate: float


class Machine(Part):
    """The machine that the times were taken on."""

    system: str
    processor: str
    cores: int | None
    python: str


class DiagnosisInShort(Part):
    """The verdict of the diagnosis that belongs to the report."""

    verdict: str
    effects: tuple[str, ...]
    recordings: tuple[str, ...]
    sentence: str


class ReportDocument(Document):
    """The whole of report.json (`bcid.report/1`), models best first, those that saw the validation take last."""

    kind: Literal["bcid.report/1"] = Field("bcid.report/1", alias="schema")
    vehicle: str
    validation: Validation
    weights: Weights
    restart_s: float
    machine: Machine
    models: tuple[ModelScore, ...]
    losses: tuple[LossScore, ...] = ()
    diagnosis: DiagnosisInShort | None = None

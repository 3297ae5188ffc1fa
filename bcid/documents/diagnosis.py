"""diagnosis.json: what a recording shows that a simulation lacks, with its proof."""

from typing import Literal, Self

from pydantic import Field, model_validator

from bcid.documents.document import Document, Figure, Interval, Number, Part
from bcid.documents.error_budget import ErrorBudget

Verdict = Literal["nothing-found", "named", "ambiguous", "unknown"]


class Quantity(Part):
    """A number with its standard error and its unit."""

    value: Number = None
    se: Number = None
    unit: str = ""
    at_bound: bool = False  # whether the search ended at a bound of its range


class Circle(Part):
    """A circle on the floor in which an effect acts."""

    x_m: float
    y_m: float
    radius_m: float


class Where(Part):
    """Where a mismatch shows: in which channel, on what it depends, in which regime, when, and at which place."""

    channel: str | None = None
    depends_on: tuple[str, ...] = ()
    regime: str | None = None
    time_s: tuple[Interval, ...] = ()
    place: Circle | None = None


class Mismatch(Part):
    """Whether simulation and recording differ by more than chance."""

    detected: bool = False
    p_value: Number = None
    where: Where | None = None


class NamedEffect(Part):
    """One finding: an effect of the vocabulary, its size, how certain it is, and how much it explains."""

    effect: str
    kind: str = ""
    twins: tuple[str, ...] = ()  # effects that explain the recording as well
    probability: Number = None
    equation: str = ""
    parameters: dict[str, Quantity] = Field(default_factory=dict)
    heldout_gain: Number = None  # nats, on blocks that the refit has not seen
    heldout_gain_ci95: Interval | None = None
    gain_nats: Number = None  # nats, on the whole recording
    gate_nats: Number = (
        None  # what chance hardly reaches with this effect: it must exceed that in more than one stretch
    )
    sentence: str = ""
    held: str | None = None  # the entry of the vehicle file of which a wrong value would look the same


class OtherFigure(Part):
    """A figure of the simulation, a parameter or the size of an effect, that is another one in this recording."""

    symbol: str  # of a parameter, or of an effect's parameter: effect__symbol
    published: float
    needed: Quantity
    gain_nats: Number = None  # by which the needed figure makes the recording likelier


class UnknownPart(Part):
    """A predictable difference between recording and simulation that matches no effect of the vocabulary."""

    channel: str | None = None
    depends_on: tuple[str, ...] = ()
    form: str | None = None  # a short formula that fits it
    heldout_gain: Number = None
    gain_nats: Number = None  # by which free functions make the recording likelier


class FitSummary(Part):
    """The held-out closed-loop error (NMSE) at one horizon, before and after the findings are added."""

    horizon_s: float
    nmse_before: Number = None
    nmse_after: Number = None
    nmse_floor: Number = None
    ratio_ci95: Interval | None = None  # of after over before


class HorizonError(FitSummary):
    """The held-out closed-loop error (NMSE) at one horizon: simulation as given, base model, findings added, noise."""

    lost: Number = None  # share of the time at which predictions leave the finite numbers
    nmse_given: Number = None
    given_lost: Number = None
    nmse_remainder: Number = None  # with free functions of the car's state beside the findings
    remainder_lost: Number = None
    remainder_ci95: Interval | None = None
    remainder_ratio_ci95: Interval | None = None  # over the error with the findings alone
    before_ci95: Interval | None = None
    after_ci95: Interval | None = None
    ratio: Number = None


class Detectable(Part):
    """The smallest size at which an effect would have been seen; null where no size would."""

    value: Number = None
    unit: str = ""


class NotExcited(Part):
    """An effect that the recording would not have shown, since the drive excites it too little."""

    effect: str
    parameter: str = ""
    smallest_detectable: Detectable | None = None


class Start(Part):
    """The pose from which a manoeuvre begins."""

    x_m: float
    y_m: float
    yaw_rad: float


class Floor(Part):
    """A rectangle of the floor along its axes, as lowest and highest place of the CoG."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]


class NextManoeuvre(Part):
    """What to drive next, and which rival explanations it tells apart."""

    name: str = ""
    purpose: str = ""
    why: str = ""
    score: Number = None  # expected difference of the rivals' log-likelihoods in one drive, nats
    repeats: int = 1  # drives until the rivals are told apart
    start: Start | None = None  # at rest, the wheel straight
    seconds: Number = None
    floor: Floor | None = None  # on which the fitted car stays in this drive: the one that the recordings drove
    separates: tuple[str, ...] = ()
    file: str | None = None  # of its commands, beside the document


class ContactSeen(Part):
    """A bump or crash, whose time is left out of the diagnosis."""

    begin_s: float
    end_s: float
    x_m: float
    y_m: float
    kind: str


class Correction(Part):
    """One of the base model's own simplifications (such as a hard tyre limit), refitted beside the findings."""

    correction: str
    equation: str
    parameters: dict[str, Quantity] = Field(default_factory=dict)


class BaseParameter(Quantity):
    """A refitted parameter of the base model."""

    symbol: str
    shown: bool = True  # whether the recording says enough of it
    of_recording: Quantity | None = None  # beside a simulation: as the recording alone shows it, if it does


class BaseModel(Part):
    """The base model that was refitted beside the findings."""

    parameters: tuple[BaseParameter, ...] = ()


class Rival(Part):
    """Another combination of effects, how far its log-likelihood lies behind, and why it was not named."""

    effects: tuple[str, ...]
    behind_nats: Figure
    why_not: str | None = None


class Placebo(Part):
    """The log-likelihood gain (nats) of an effect that cannot be there: how much chance alone explains."""

    name: str
    gain_nats: Figure


class Located(Part):
    """Where the mismatch was found before any effect was named."""

    channel: str | None = None
    place: tuple[float, float, float] | None = None  # x, y, radius (m)
    window_s: Interval | None = None


class Unexplained(Part):
    """What free functions still explain of the recording beside the findings."""

    channel_nats: dict[str, Figure] = Field(default_factory=dict)  # that those of each channel add beside the others'
    gain_nats: Figure = 0.0  # that all add, where they add more than chance


class LawCurve(Part):
    """The missing law in one channel, as free functions show it: a curve with a band.

    Where it swings in time, `quantity` is the time within one period.
    """

    quantity: str  # over which it is drawn, such as v_x
    unit: str = ""  # of the quantity
    y_unit: str = ""
    x: tuple[Figure, ...] = ()
    y: tuple[Figure, ...] = ()
    sd: tuple[Figure, ...] = ()  # standard deviations of y
    named: tuple[Figure, ...] | None = None  # what the findings alone would have shown; null without findings
    period_s: Number = None
    direction: str | None = None  # in which a wave acts; null for the channel's own component of the body

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        """Refuse curves whose columns are not equally long."""
        columns = (self.x, self.y, self.sd, self.x if self.named is None else self.named)
        if len({len(column) for column in columns}) > 1:
            raise ValueError("x, y, sd and named are not equally long")
        return self


class ChannelRemainder(Part):
    """What free functions explain in one channel (nats, beside those of the others), and the law that they show."""

    channel: str
    nats_before: Figure = 0.0  # before any hypothesis
    nats_left: Figure = 0.0  # beside the findings
    curve: LawCurve | None = None  # before any hypothesis; null where the channel does not stand out


REFITTED = "newton-euler, refitted on this recording"
"""What recordings are compared with where no simulation is given."""


class DiagnosisDocument(Document):
    """The whole of diagnosis.json (`bcid.diagnosis/2`); of version 1, which is read still, `remainder` is empty."""

    kind: Literal["bcid.diagnosis/1", "bcid.diagnosis/2"] = Field("bcid.diagnosis/2", alias="schema")
    vehicle: str = ""
    recordings: tuple[str, ...] = ()
    duration_s: Number = None
    simulation: str = ""
    verdict: Verdict
    mismatch: Mismatch = Mismatch()
    channels: dict[str, Figure] = Field(
        default_factory=dict
    )  # nats that free functions in one channel explain before any hypothesis
    findings: tuple[NamedEffect, ...] = ()
    other_figures: tuple[OtherFigure, ...] = ()  # of the simulation, most certain first
    unknown: UnknownPart | None = None
    fit: FitSummary | None = None
    horizons: tuple[HorizonError, ...] = ()
    not_excited: tuple[NotExcited, ...] = ()
    next_manoeuvre: NextManoeuvre | None = None
    contacts: tuple[ContactSeen, ...] = ()
    corrections: tuple[Correction, ...] = ()
    base: BaseModel = BaseModel()
    rivals: tuple[Rival, ...] = ()
    placebos: tuple[Placebo, ...] = ()
    dropped: tuple[str, ...] = ()  # effects that were tried, and add nothing beside free functions
    others_nats: dict[str, Figure] = Field(
        default_factory=dict
    )  # that each effect of the vocabulary would add beside the findings and free functions, to first order
    nat_sizes: dict[str, dict[str, Figure]] = Field(
        default_factory=dict
    )  # by effect and parameter, how large one that is not found had to be (SI) for the drive to show one nat of it
    gate_nats: Number = None  # what chance hardly reaches on these recordings, with whatever it may be
    stretches: int | None = None  # of 1.5 s, in which the recordings are predicted
    located: Located | None = None
    unexplained: Unexplained | None = None
    remainder: tuple[ChannelRemainder, ...] = ()
    error_budget: ErrorBudget | None = None  # of earlier diagnoses, and where no prediction stays finite, null

    @property
    def compared_with(self) -> str:
        """What the recordings are compared with, in a word: a simulation that was given, or else a fitted model."""
        return "model" if self.simulation in ("", REFITTED) else "simulation"

    @property
    def where(self) -> Where:
        """Where the mismatch shows; empty where none was detected."""
        return self.mismatch.where or Where()

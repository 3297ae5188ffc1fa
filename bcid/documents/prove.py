"""prove.json: what a blind test amounts to, tier by tier beside its goals, with its seal and its wrong answers."""

from typing import Literal

from pydantic import Field

from bcid.documents.document import Document, Interval, Number, Part


class TierScores(Part):
    """Scores of one tier: shares of its takes unless stated; null where no take of the tier has the score."""

    tier: str
    n: int
    right: float  # answered as they should be, with nothing wrong beside
    top1: Number = None  # the first finding is there
    set: Number = None  # what is there is among the findings and their twins
    exact: Number = None  # the findings are what is there, no more and no less
    false: Number = None  # something is named where nothing is there
    false_ci95: Interval | None = None
    unknown: float  # verdict unknown
    wrong: Number = None  # something is named that is not there, nor a twin of what is
    set_size: Number = None  # mean number of findings and twins
    parameter_error: Number = None  # median relative error
    coverage: Number = None  # 95 % intervals that hold the true parameter
    coverage_ci95: Interval | None = None
    oracle_share: Number = None  # median, of the held-out gain of the true structure
    unshown: Number = None  # even the true effect, refitted, does not gain what a name asks for
    denied: Number = None  # of effects that show: reported as not excited all the same
    more: Number = None  # of right names: something is reported as unexplained beside them
    kind: Number = None  # of measurement effects: as many are named, and nothing wrong of another kind
    channel: Number = None  # of effects without a name: verdict unknown, in the right channel
    located: Number = None  # the channel that stands out before any hypothesis is right
    place_overlap: Number = None  # mean intersection over union
    time_overlap: Number = None  # mean intersection over union
    not_seen: Number = None  # of effects that do not show: not named, and reported as not excited
    false_figures: Number = None  # mean number of figures told to be others than published that are not
    seconds: Number = None  # median time of a diagnosis
    errors: int
    goal: dict[str, Interval] = Field(default_factory=dict)  # lowest and highest wanted value by score
    missed: tuple[str, ...] = ()  # scores outside their goals

    def score(self, name: str) -> float | None:
        """The value of one score by its name; None where the tier has none."""
        value: float | None = getattr(self, name)
        return value


class RightAnswers(Part):
    """Right answers, how many are wanted, and how likely as few are by chance, were the goals just met."""

    right: int
    n: int
    expected: float
    p: float


class CalibrationBin(Part):
    """Findings whose stated probability lies in (low, high]: its mean, and the share of them that was there."""

    low: float
    high: float
    n: int
    stated: float
    there: float
    there_ci95: Interval | None = None


class Calibration(Part):
    """Findings by stated probability, with their Brier score."""

    n: int
    brier: Number = None
    bins: tuple[CalibrationBin, ...] = ()


class NullPValues(Part):
    """The share of takes of nothing with a p-value of at most `level`, which it should equal."""

    n: int
    level: float
    share: float
    ci95: Interval


class WrongAnswer(Part):
    """A wrongly answered case: its name, which effects are there, and what was said."""

    case: str
    there: str
    said: str


class MethodScores(Part):
    """One method on the same takes: pairs of hits and takes, medians of the explained share and of the seconds."""

    method: str
    n: int
    top1: tuple[int, int] | None = None  # of a method that can name
    false: tuple[int, int] | None = None
    detected: tuple[int, int] | None = None
    explained: Number = None  # of the error
    failed: int
    seconds: Number = None


class ProveDocument(Document):
    """The whole of prove.json (`bcid.prove/1`)."""

    kind: Literal["bcid.prove/1"] = Field("bcid.prove/1", alias="schema")
    seed: int | None = None
    salt: str = ""
    quick: bool = False
    sizes: dict[str, int] = Field(default_factory=dict)  # options from which the cases are drawn
    of: int | None = None  # cases that there are
    tiers_of: dict[str, int] = Field(default_factory=dict)  # and of each tier
    seal: str | None = None  # of all answers, written before the first case; null where they are not sealed
    opened: int | None = None  # cases whose seals were opened
    known_before: int = 0  # cases that had been run before the sealing
    made_after_opening: int = 0  # rows that were made after answers had been opened
    code: str = ""  # digest of the code that makes a row
    cases: int
    versions: dict[str, str]
    tiers: tuple[TierScores, ...]
    pooled: RightAnswers
    pooled_by_tier: dict[str, RightAnswers]
    calibration: Calibration
    p_values: NullPValues | None = None
    confusion: dict[str, dict[str, int]]  # by effect concealed alone, or nothing: how often which first name was given
    wrong: tuple[WrongAnswer, ...] = ()
    missed: tuple[str, ...] = ()  # goals, in words
    baselines: tuple[MethodScores, ...] = ()  # other methods on the same takes

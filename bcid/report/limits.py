"""Numbers that decide what pages and pictures show, and what they leave out."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ReportLimits:
    """Limits of pages and pictures; all were chosen by looking at pages, none is justified by committed figures yet."""

    # Knots below which a picture of the disturbance is left out.
    min_knots: int = 48
    # Knots in a bin below which its median is left out.
    min_knots_per_bin: int = 10
    # Rows in a bin of the steering angle below which a model's error is left out.
    min_rows_per_bin: int = 6
    # Correlation above which the second of two quantities is not drawn.
    max_correlation: float = 0.8
    # Share of the recording above which a located time is described as the whole of it.
    whole_recording_share: float = 0.95
    # Knots per square that the squares of the floor map are sized for.
    knots_per_square: int = 16
    # Share of them below which a square is grey, as hardly driven over.
    driven_square_share: float = 0.25
    # Factor by which places must explain more of the disturbance's size than of its mean for the map to show sizes.
    magnitude_factor: float = 1.5
    # Lowest share of the variance of the size that places must explain for the map to show sizes.
    min_explained_share: float = 0.02
    # Channels whose missing law is drawn, those that explain most first.
    max_laws: int = 2
    # Standard deviations to either side of a curve that its band is wide.
    band_sd: float = 2.0
    # Stretches of 1.5 s below which a page says what so short a take can show: no kind of simulated take on which
    # verdicts are counted (docs/results/prove.json) lasts less than 45 s.
    short_stretches: int = 30
    # Share of an error below which its change is told as hardly any, and what the evidence is instead.
    hardly_changed_share: float = 0.02
    # Times the noise floor above which the verdict says what keeps the error there.
    above_floor: float = 1.5
    # Share of the error that the low end of its interval must exceed for a sentence to say that something is left.
    told_share: float = 0.005
    # Effects that a sentence names of those that the drive did not show.
    told_effects: int = 3
    # Rows from which a table is folded.
    folded_rows: int = 8


LIMITS = ReportLimits()

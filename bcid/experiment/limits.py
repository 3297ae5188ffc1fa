"""Every number that decides which drives are offered, which sizes count as detectable and when a plan is long enough.

"Blind test" stands for docs/results/prove.json with the rows in docs/results/proof.  No limit has been varied alone.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ExperimentLimits:
    """Which drives are offered and chosen, and when they show an effect or discriminate two explanations."""

    # Shortest drive (s) without its stop: cut shorter, a pattern would not show what it is for.  Not yet justified.
    min_drive_s: float = 18.0
    # Longest drive (s) without its stop.  Not yet justified.
    max_drive_s: float = 38.0
    # Repeats that a drive may need to separate two explanations; beyond, none is offered.  Not yet justified.
    max_repeats: int = 50
    # Multiple of an effect's declared size beyond which the take is said not to excite it.  Blind test: 6 of 6 effects
    # that the drive did not excite are listed.
    max_size_multiple: float = 50.0
    # Share of an effect's typical places at which it must show to count as detectable.  Not yet justified.
    min_share_of_places: float = 0.5
    # Drives of a plan, repetitions among them: about a quarter of an hour.  Not yet justified.
    max_drives: int = 24
    # Progress per second of driving, in effects that show in full, below which no drive is added.  Not yet justified.
    min_progress_per_s: float = 1e-3
    # Expected gain of an effect over what it needs, up to which drives are added: the gain of a take varies.  Not yet
    # justified.
    gain_margin: float = 1.5
    # Multiple of the declared size from which on an effect would still show if the plan were repeated.  Not yet
    # justified.
    max_promising_ratio: float = 2.0


EXPERIMENT_LIMITS = ExperimentLimits()

"""Every number of a diagnosis that decides what is named, refused or left out.

Gains are penalised log-likelihoods in nats.  A "take of nothing" lacks no physics of the base model: 300 are the tier
"null" of the blind test, 400 the tiers "null" and "null-imperfect" (a car whose base model is slightly wrong).  "Blind
test" stands for docs/results/prove.json with the rows in docs/results/proof, "DART" for docs/results/real_dart.json.
Half and twice of each limit that decides changed 2 of 1440 verdicts of 60 takes (docs/results/limits.json), in a
search before today's, whose remainder_error was 0.1.  Which of them decide the verdict stands in DECIDING_LIMITS; `bcid
prove --limits` halves and doubles each.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class SearchLimits:
    """What the search for names tries, and what makes a name."""

    # Probability that any effect passes its own gate on a take of nothing, or that all together pass theirs.
    gate_p_value: float = 1e-4
    # Share of what a remainder explains that smooth functions cannot follow: a name, and a wave, must add more, and
    # evidence to first order is no better known.  Set after seeing simulated takes of unknown physics, twice: at 0.1
    # seven false names fell that added 1 to 9 %, where refits ended by luck; now that they converge, what was tried
    # beside unknown physics added 3 % at most, and a right name in a car of other formulas 8 %.
    remainder_error: float = 0.05
    # Share of what a remainder explains which a further refit of it must gain: smooth functions miss more than that.
    # What evidence without a name may lack so, the name must add beyond it.
    converged_share: float = 0.01
    # Share of what a remainder explains beyond which a fit's own gain leaves so little that it is found from nothing.
    most_share: float = 0.5
    # Share of what a name adds which a channel must add beside all names, for copies of laws in it to take its place.
    needed_share: float = 0.2
    # Nats within which evidence to first order decides nothing.
    near_nats: float = 10.0
    # Names given in one take.  Three at most are concealed in the blind test.
    max_effects: int = 6
    # Share of the gate below which an effect's score beside the remainder is not followed up.
    min_score_share: float = 0.5
    # Share of the best score below which it is not.
    near_best_share: float = 0.2
    # Share of what the score test promises of an effect, below which it is tried beside the remainder, too.
    kept_promise: float = 0.5
    # Candidates that are refitted in one round, best score first.
    max_candidates: int = 4
    # Effects that are refitted for what they promise without a remainder, best score first.
    plain_candidates: int = 2
    # Standard errors from zero at which a correction of the base model is certain.
    certain_se: float = 8.0
    # Effects for which each name is exchanged, best score first.
    max_exchanges: int = 3
    # Nats that a wave must gain beyond the price of its choice.  Half and twice of it change no verdict of 60 takes.
    min_wave_nats: float = 8.0
    # Standard deviations from zero at which a coefficient of the remainder is refitted.  At 0.7 converged evidence was
    # the same within 1 nat on a take of the blind test and a drive of DART, with half as many functions more.
    needed_sd: float = 1.5


@dataclass(frozen=True)
class JudgeLimits:
    """What is said of names, and with which probability."""

    # Smallest p-value claimed: places and times are compared with some hundred shuffled takes.
    min_p_value: float = 1e-3
    # Longest block (s) held out or resampled: as long as pushes may be correlated.
    max_block_s: float = 20.0
    # Blocks of a shorter take: of fewer, a bootstrap shows no scatter.
    min_blocks: int = 12
    # Nats within which two explanations are indistinguishable (55 : 1).
    rival_nats: float = 4.0
    # Standard errors of their difference (Vuong 1989) within which two explanations are indistinguishable.
    rival_se: float = 2.0
    # Nats beyond which standard errors do not make two explanations indistinguishable.
    max_rival_nats: float = 20.0
    # Indistinguishable effects listed with a name: three at most are asked for.
    max_twins: int = 3
    # Probability, by the trust in a simulation, that one of its figures lies as far off, below which it is another one.
    figure_p_value: float = 0.05
    # Divides differences of nats in stated probabilities.
    probability_temper: float = 2.0
    # Multiple of its declared size at which an effect must show to count as excited.
    unexcited_sizes: float = 3.0


@dataclass(frozen=True)
class LocateLimits:
    """What is said of the place, time, channel and dependence of a mismatch before any hypothesis."""

    # Largest p-value at which a place, a time or a mismatch as a whole is reported.  Blind test: of 300 takes of
    # nothing none has a place and three have a time.
    significant_p_value: float = 0.01
    # Mean energy of the pushes in a regime over that elsewhere.  Not yet justified.
    min_regime_energy_ratio: float = 1.5
    # Knots in a regime, and elsewhere.  Not yet justified.
    min_regime_knots: int = 40
    # Quantile of speed, steering angle, steering rate or slip beyond which a regime is; below its complement the car
    # goes straight.  Not yet justified.
    regime_quantile: float = 0.75
    # Share of the speed at this quantile from which a car reverses.  Not yet justified.
    min_reversing_share: float = 0.05
    # Knots within a circle or window of a scan.  Not yet justified.
    min_scan_knots: int = 12
    # Metres between circles, of a vehicle as large and fast as the bumper car.  Not yet justified.
    min_circle_distance_m: float = 0.6
    # Energy at which the push of one knot is clipped, so that it makes no place alone.  Not yet justified.
    max_knot_energy: float = 30.0
    # Share of what a channel's functions explain which must vary for it to depend on anything, and of that the share
    # which must depend on a quantity to name it.  Not yet justified.
    min_quantity_share: float = 0.3
    # Quantities that are reported, the strongest first.  Not yet justified.
    max_quantities: int = 2
    # Regimes that are reported.  Not yet justified.
    max_regimes: int = 2


@dataclass(frozen=True)
class SummaryLimits:
    """What of a diagnosis is written to diagnosis.json."""

    # Relative standard error from which a parameter of the base model is not quoted as known.  Not yet justified.
    max_relative_se: float = 0.2
    # Placebos that are listed, the best first: as many as a reader compares.
    max_placebos: int = 3
    # Rival explanations that are listed, the best first: as many as a reader compares.
    max_rivals: int = 4
    # Bins of a curve: as many as a picture shows.
    curve_bins: int = 25
    # Knots (0.125 s) in a bin below which it is joined with the next.
    min_knots_per_bin: int = 20
    # Points below which there is no curve.
    min_curve_bins: int = 3


SEARCH_LIMITS, JUDGE_LIMITS, LOCATE_LIMITS = SearchLimits(), JudgeLimits(), LocateLimits()
SUMMARY_LIMITS = SummaryLimits()

DECIDING_LIMITS = {
    "gate_p_value": SEARCH_LIMITS, "remainder_error": SEARCH_LIMITS, "near_nats": SEARCH_LIMITS,
    "min_score_share": SEARCH_LIMITS, "near_best_share": SEARCH_LIMITS, "kept_promise": SEARCH_LIMITS,
    "certain_se": SEARCH_LIMITS, "needed_share": SEARCH_LIMITS, "min_wave_nats": SEARCH_LIMITS,
    "rival_nats": JUDGE_LIMITS, "rival_se": JUDGE_LIMITS, "max_rival_nats": JUDGE_LIMITS,
}  # fmt: skip
"""The limits by which a verdict may be another, and where each stands: a dozen at most.

Those of JUDGE_LIMITS are used after the search only.  Of the others some say how results are shown or how sure they are
said to be (`max_twins`, `probability_temper`, `unexcited_sizes`), some how far a computation goes (`max_candidates`,
`max_exchanges`, `max_effects`, `plain_candidates`, `needed_sd`), and some how a scatter is estimated
(`max_block_s`, `min_blocks`).
"""


@contextmanager
def limit_set_to(name: str, value: float) -> Iterator[None]:
    """Context manager: the limit `name`, a key of DECIDING_LIMITS, is `value` in its block, in this process only.

    Only for the proof that verdicts do not hang on a limit (`bcid prove --limits`); nothing else may change one.  All
    threads of the process see the changed limit.  Afterwards the limit is as it was, whatever is raised.

    Raises:
        KeyError: there is no such limit.
    """
    limits = DECIDING_LIMITS[name]
    before = getattr(limits, name)
    # a frozen dataclass keeps everybody from changing a limit, but for this proof
    object.__setattr__(limits, name, value)
    try:
        yield
    finally:
        object.__setattr__(limits, name, before)

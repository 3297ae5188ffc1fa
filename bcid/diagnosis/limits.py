"""Every number of a diagnosis that decides what is named, refused or left out.

Gains are penalised log-likelihoods in nats.  A "take of nothing" lacks no physics of the base model: 300 are the tier
"null" of the blind test, 400 the tiers "null" and "null-imperfect" (a car whose base model is slightly wrong).  "Blind
test" stands for docs/results/prove.json with the rows in docs/results/proof, "DART" for docs/results/real_dart.json.
No limit has been varied alone: the figures show what all of them do together.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchLimits:
    """What the search for missing effects tries, refits and accepts."""

    # Probability that a take of nothing passes the gate.  Blind test: 1 of 300 takes of nothing was given a name.
    gate_p_value: float = 1e-4
    # A gain that chance does not reach.  Blind test: the one name given to nothing gained 37 nats, all others over 141.
    plain_gain_nats: float = 100.0
    # Effects named in one take.  Blind test: three at most; all 20 takes with three effects were named in full.
    max_effects: int = 4
    # Effects named in a take predicted under pushes, whose base model is far off.  DART: six at most.
    max_effects_under_pushes: int = 6
    # Candidates that are refitted in one round, best score first.  Not yet justified.
    max_candidates: int = 8
    # Score (nats) below which a candidate is not refitted.  Not yet justified.
    min_score_nats: float = 6.0
    # Share of the best score below which a candidate is not refitted.  Not yet justified.
    min_score_share: float = 0.03
    # Share of the best gain within which a quick refit is followed by a full one.  Not yet justified.
    near_best_share: float = 0.1
    # Nats from the best gain within which a quick refit is followed by a full one.  Not yet justified.
    near_best_nats: float = 20.0
    # Refits from either kind of start that are carried to the end.  Not yet justified.
    max_finalists: int = 3
    # Share that an effect must gain of what trees predict of the pushes: a mixture of effects, each of which explains
    # little, would stand in for one without a name.  Blind test: 26 of 27 effects outside the vocabulary stay unnamed.
    min_predictable_share: float = 0.25
    # Share of all that is explained so far which a further effect must add.  Not yet justified.
    min_explained_share: float = 0.01
    # Standard errors from zero at which no refit without the effect is needed.  Not yet justified.
    certain_se: float = 8.0
    # Share of a take at each end in which a change of the car only makes up for wrong base parameters.  Not yet
    # justified.
    edge_share: float = 0.08
    # Effects, of those tried from their sizes, of which the first are refitted on the whole take.  Not yet justified.
    max_sized_effects: int = 8
    # Nats that a segment counts for at most on a part of a take: a bad prediction costs thousands.  Not yet justified.
    max_segment_nats: float = 50.0
    # Share of what is required, and of the best promise, from which a promise on a part of a take is followed up.  Not
    # yet justified.
    likely_share: float = 0.5
    # Standard deviations by which a promise on a part of a take may miss what is required.  Not yet justified.
    likely_sd: float = 2.0
    # Effects for which each accepted one is exchanged in a round, best score first.  Not yet justified.
    max_exchanges: int = 3


@dataclass(frozen=True)
class JudgeLimits:
    """What makes findings of accepted effects, and with which probability."""

    # Smallest p-value claimed: 999 takes of nothing are drawn.  Blind test: p < 0.05 in 3.7 % of 300 takes of nothing.
    min_p_value: float = 1e-3
    # Longest block (s) held out or resampled: as long as pushes may be correlated.  Not yet justified.
    max_block_s: float = 20.0
    # Blocks of a shorter take: of fewer, a bootstrap shows no scatter.  Not yet justified.
    min_blocks: int = 12
    # Nats within which two explanations are indistinguishable (55 : 1).  Blind test: 28 of 600 names have a twin.
    rival_nats: float = 4.0
    # Standard errors of their difference (Vuong 1989) within which two explanations are indistinguishable.  Blind test:
    # all 123 single effects of perfect takes are named first.
    rival_se: float = 2.0
    # Nats beyond which standard errors do not make two explanations indistinguishable.  Not yet justified.
    max_rival_nats: float = 20.0
    # Indistinguishable effects listed with a name.  Blind test: one at most.
    max_twins: int = 3
    # Share of an effect's declared size below which it matters to no prediction.  Not yet justified.
    min_size_share: float = 0.05
    # Divides differences of nats in stated probabilities.  Blind test: of 595 names stated with 0.993, 98.3 % were
    # right.
    probability_temper: float = 2.0
    # Prior nats against an effect in no vocabulary (1 : 150).  Blind test: those same 595 names.
    unknown_prior_nats: float = 5.0
    # Multiple of its declared size at which an effect must show to count as excited.  Blind test: all 6 unexcited ones
    # are listed.
    unexcited_sizes: float = 3.0


@dataclass(frozen=True)
class ProxyLimits:
    """When an accepted effect is a proxy, which only stands in for something that has no name.

    Blind test: 26 of 27 effects outside the vocabulary and 35 of 41 left out of it are given no other name.
    """

    # Share of all that is explained from which a remainder is reported beside it.  Not yet justified.
    min_remainder_share: float = 0.02
    # Share of all that is explained which may stay predictable.  Blind test: 99 % of named takes leave less than 0.22.
    max_remainder_share: float = 0.1
    # Share of what an effect explains which may remain in a channel beside the effect.  Not yet justified.
    max_channel_share: float = 0.15
    # Share of that channel which an effect must explain to be a proxy.  Not yet justified.
    min_overlap_share: float = 0.25
    # Replaces both shares that may remain, for a take predicted under pushes: more is missing than has a name.
    # DART: of 11 withheld effects 5 are named rightly, and one is unknown in its channel.
    max_share_under_pushes: float = 0.5
    # Gain over what free functions promise to first order, beyond which the gain counts.  Not yet justified.
    first_order_factor: float = 3.0
    # Correlation of what is left with what trees predict of it.  Blind test: below 0.27 in 99 % of named takes.
    min_correlation: float = 0.4
    # Share of an effect's relief of the pushes which must go where a channel's do.  Not yet justified.
    min_relief_share: float = 0.25


@dataclass(frozen=True)
class LocateLimits:
    """What is said of the place, time, channel and dependence of a mismatch before any hypothesis."""

    # Largest p-value at which a place, a time or a mismatch as a whole is reported.  Blind test: of 300 takes of
    # nothing none has a place and three have a time.
    significant_p_value: float = 0.01
    # Mean energy of the pushes in a regime over that elsewhere.  Not yet justified.
    min_regime_energy_ratio: float = 1.5
    # Knots in a regime, and elsewhere.  Not yet justified.
    min_regime_knots: int = 20
    # Quantile of speed, steering angle, steering rate or slip beyond which a regime is; below its complement the car
    # goes straight.  Not yet justified.
    regime_quantile: float = 0.75
    # Share of the speed at this quantile from which a car reverses.  Not yet justified.
    min_reversing_share: float = 0.05
    # Knots within a circle or window of a scan.  Not yet justified.
    min_scan_knots: int = 6
    # Metres between circles, of a vehicle as large and fast as the bumper car.  Not yet justified.
    min_circle_distance_m: float = 0.6
    # Energy at which the push of one knot is clipped, so that it makes no place alone.  Not yet justified.
    max_knot_energy: float = 30.0
    # Standard deviations at which the push of one knot is clipped, so that it makes no correlation alone.  Not yet
    # justified.
    max_strength_sd: float = 12.0
    # Correlation with what trees predict beyond which pushes are predictable, in a long take.  Blind test: at most 0.15
    # in 300 takes of nothing (tier "null"), at least 0.24 in 41 with an effect that may not be named.
    min_correlation: float = 0.25
    # Standard errors of no correlation beyond which pushes are predictable, in a short take.  Not yet justified.
    min_correlation_se: float = 4.0
    # Share of the trees' importance from which a quantity is said to matter.  Not yet justified.
    min_importance: float = 0.15
    # Share of the trees' correlation from which a formula is given.  Not yet justified.
    min_formula_share: float = 0.8
    # Correlation of a term of a formula with what the others leave.  Not yet justified.
    min_term_correlation: float = 0.125
    # Quantities that are reported, the strongest first.  Not yet justified.
    max_quantities: int = 2
    # Regimes that are reported.  Not yet justified.
    max_regimes: int = 2
    # Terms of a formula that are reported.  Not yet justified.
    max_formula_terms: int = 2
    # Nats from which basis functions or push directions explain something.  Blind test: in 400 takes of nothing (tiers
    # "null" and "null-imperfect") no function and two directions reach them; 41 effects that may not be named gain at
    # least 164.
    min_gain_nats: float = 5.0
    # Share of the nats that trees predict which a channel must explain to be named by it.  Not yet justified.
    min_predicted_share: float = 0.1


@dataclass(frozen=True)
class SummaryLimits:
    """What of a diagnosis is written to diagnosis.json."""

    # Relative standard error from which a parameter of the base model is not quoted as known.  Not yet justified.
    max_relative_se: float = 0.2
    # Placebos that are listed, the best first: as many as a reader compares.
    max_placebos: int = 3
    # Rival explanations that are listed, the best first: as many as a reader compares.
    max_rivals: int = 4


SEARCH_LIMITS, JUDGE_LIMITS, PROXY_LIMITS, LOCATE_LIMITS = SearchLimits(), JudgeLimits(), ProxyLimits(), LocateLimits()
SUMMARY_LIMITS = SummaryLimits()

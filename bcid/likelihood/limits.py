"""Every number of the likelihood that decides what of a take is used, which parameters are possible, which fit stands.

A limit without a figure is not yet justified.  "DART" stands for docs/results/real_dart.json with
docs/real_recordings.md, "blind test" for docs/results/prove.json with the rows in docs/results/proof.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class LikelihoodLimits:
    """What is left out of a take, bounds of parameters, and what a refit or a score test may claim."""

    # Segments of 1.5 s in motion, below which recordings are refused.  The gate is drawn from 999 random signs of the
    # segments' residuals: of S there are 2^(S - 1) that differ by more than one common sign, a thousand from S = 11 on;
    # of fewer the draws repeat each other.  Scatter is estimated over 12 blocks (`min_blocks` of a diagnosis), each of
    # which needs a segment.  Numbers are no bound: half of 12 segments have some 180 more than there are initial states
    # and pushes, at the least coverage, and a hypothesis of six names has some 40 parameters.  So many must lie before,
    # and after, a change in time: of two minutes of the DART's three changes of mass were named 7 to 10 s after the
    # start (before, a change within 8 % of either end was refused).
    min_segments: int = 12
    # Share of a segment's groups of poses that have to be there.  Not yet justified.
    min_coverage: float = 0.6
    # Extent of a segment (wheelbases, rad) up to which the car stands.  Not yet justified.
    standing_extent: float = 0.01
    # Difference (rad) of wheels that began at either lock, above which their angle is unknown.  Not yet justified.
    unknown_wheel_angle_rad: float = 1e-4
    # Bounds of I_z over m l_f l_r, as a factor either way.  Not yet justified.
    inertia_factor: float = 5.0
    # Bounds of C_f and C_r over m times 1 N/rad per kg, as a factor either way.  Not yet justified.
    stiffness_per_mass_factor: float = 100.0
    # Share of the bounds of `marker_offset` that remains where the tracked point was measured.  Not yet justified.
    measured_marker_share: float = 0.5
    # Distance in phi from a bound within which a parameter is at its bound: as near as refits end.
    near_bound: float = 1e-3
    # Standard deviation in phi (logarithms; R_1 and R_2 in their units) of base parameters before a fit that trusts no
    # simulation: weak, so that it decides only what a take does not show.  Not yet justified.
    base_prior_sd: float = 1.5
    # Scales of its trust within which a figure of a simulation holds: no other start of the base model is tried then.
    held_sd: float = 3.0
    # Change of a predicted pose (m, rad) by a trial, from which it says nothing: no car is a thousand kilometres off
    # after a segment.  On the F1TENTH, its poses 0.05 s later, a trial was off by 2e158 m, and its square no number.
    lost_change: float = 1e6
    # Multiple of a trial's size that a score test may claim: the tangent says nothing beyond.  Not yet justified.
    max_trial_amplitude: float = 3.0
    # Information (nats per squared multiple) below which a take does not excite a trial: only rounding is smaller.
    min_information: float = 1e-9
    # Correlation of a push with the next, a quarter of a second later, at most: that of means over a floor whose
    # roughness decays within 0.3 s.  What lasts for longer cannot be told from a law that is missing: with up to 0.95
    # functions seemed to explain 73 nats of what refits with them explain 375 of, with 0.6 127 of 493.  And segments
    # begin anew, so that of pushes which last evidence is overstated.
    most_lasting: float = 0.6
    # Gain (nats) that counts where chance is not drawn for the take: plans and corrections.  Blind test: 600 names
    # gained 36 nats or more.
    usual_gate_nats: float = 14.0


@dataclass(frozen=True)
class SegmentLimits:
    """Which segments of 1.5 s are predicted badly, and when they are tried from other initial states."""

    # chi^2 per measured number (about 1 is expected) from which a segment is begun anew.  In a search on the DART's
    # 10_02_28 none of 1,750 below 10 was worth 5 nats more so, and 14 of 19 above 20 were, by 163 to 367 in the mean.
    restart_chi2: float = 10.0
    # Nats that a segment may lose by a step of its own: more, and its tangent has misled it.  Not yet justified.
    max_loss_nats: float = 3.0


LIKELIHOOD_LIMITS, SEGMENT_LIMITS = LikelihoodLimits(), SegmentLimits()

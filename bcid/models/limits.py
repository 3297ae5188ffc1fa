"""Every number of the models that decides which data a fit uses, what it states, and which rollouts are refused.

A limit without a figure is not yet justified.  "Fits to known cars" stands for docs/results/parameters.json.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelLimits:
    """Which takes are refused, held out or left out, which constants are stated, and which models are refused."""

    # Quantile of all speeds and yaw rates by which takes are judged to excite a fit.
    excitation_quantile: float = 0.95
    # Speed (m/s) there below which takes are refused: a car that stands identifies no constant.
    min_speed_mps: float = 0.05
    # Yaw rate (rad/s) there below which takes are refused: a car that drives straight identifies no constant of its
    # tyres.
    min_yaw_rate_radps: float = 0.02
    # Share of every take, its end, where networks choose their epoch and process noise is found.
    validation_share: float = 0.1
    # Share of every take, its end, where K-SINDy chooses its threshold.
    threshold_share: float = 0.2
    # Fewest horizons in that end.
    min_threshold_horizons: int = 3
    # Starts of stretches of a loss of rollouts within the length of one.  With 1 the error of one drive's prediction
    # depended by 20 % on the row with which the take begins, with 4 by 7 %, with 10 by 4 %; more cost time only.
    starts_per_stretch: int = 10
    # Stretches from which on their starts are farther apart: sixteen minutes of driving at ten starts per 2 s.
    max_stretches: int = 5000
    # Length of a take over that of its end, below which nothing of it is held out.
    min_ends_per_take: int = 4
    # Change of the twist in a period over its 0.9 quantile, beyond which the initial guess leaves out a sample.
    max_relative_change: float = 20.0
    # Standard error over the value, above which a constant is not identified.  Fits to known cars: of the rear grip,
    # which those takes never reach, 2 of 300 fits state a value all the same.
    max_relative_se: float = 0.5
    # Standard error over the prior's, above which poses have taught too little of a constant.
    max_prior_sd_share: float = 0.5
    # Norm of a column of the Jacobian (root NMSE per width of the range) below which a constant does not act.
    min_sensitivity: float = 1e-6
    # Gain (nats) over a car without a saturation force, all other constants fixed, below which the force is not stated:
    # chance made one worth two nats in one of sixteen takes.
    min_saturation_nats: float = 6.0
    # Standard errors by which twists must be predicted worse without a saturation force: 95 % on one side.
    saturation_z: float = 1.645
    # Correlation of two constants' errors above which the pair is reported.
    min_correlation: float = 0.95
    # Share of the logarithmic range within which a constant is at its bound.
    bound_margin: float = 0.01
    # |v_x|, |v_y| (m/s) and |yaw rate| (rad/s) beyond which a rollout has diverged: no ground vehicle is as fast, and
    # polynomials that run away pass it long before they overflow.
    fastest_twist: tuple[float, float, float] = (150.0, 150.0, 100.0)
    # Delay (s) of commands in a saved model, twenty times the bound of such an effect: a damaged file could ask for
    # anything.
    max_delay_s: float = 10.0
    # Least value (SI) of a constant of a saved model that is divided by: quotients of a few stay finite.
    min_constant: float = 1e-12
    # Largest value (SI) of a number of a saved model: that of any fit is some 1e9 (the force limit of a lorry whose
    # throttle sets a force), and products of a few stay finite.
    max_constant: float = 1e12
    # Length (s) of the recording that a saved model's effects count in: four months.
    max_recording_s: float = 1e7
    # Periods over which a saved model's commands may be delayed: those on their way are copied at every step, and so
    # many cost it 60 µs.
    max_delay_periods: int = 1000
    # Steering command (rad) of a saved model: half a turn.
    max_steering_rad: float = 3.1416
    # Terms of an equation of a saved K-SINDy, forty times the library's: a step works through all of them.
    max_terms: int = 640
    # Factors of a term of it, twice the library's, for the same reason.
    max_factors: int = 8
    # Size of a saved model's arrays, a thousand times that of the default networks, for the same reason.
    max_array_bytes: int = 1 << 28
    # Largest error (m/s, rad/s) of a rollout in single precision, which is used where as much is accepted.  A thousand
    # Newton-Euler rollouts of 5 s are off by 1.5e-6.
    single_precision_error: float = 1e-5


LIMITS = ModelLimits()

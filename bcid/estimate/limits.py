"""Numbers that decide what the estimator refuses, identifies, reports as unreliable or leaves out."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EstimateLimits:
    """Limits of the estimator.  A value is not yet justified where its comment names no reason."""

    # Restarts of a filter that loses the car, beyond which the recording is refused.
    max_restarts: int = 20
    # |v_x| (m/s) below which slip angles and the twist's covariance are singular (errata 15): rows left out, and
    # counted, of RMSE and NEES.
    min_slip_speed_mps: float = 0.1
    # Standard deviation of the commanded angle (rad) above which a take serves to identify the steering.
    min_steering_sd_rad: float = 0.02
    # Rows of raw motion above which a take serves to identify the steering.
    min_steering_rows: int = 200
    # Distance (natural logarithm) from a bound of its search within which T_s or d is reported as at the bound; ten
    # times what least squares resolves there.
    steering_bound_ln: float = 1e-2
    # Share of d that the steering's rate must exceed once: below it, any larger d would fit as well.
    rate_reached_share: float = 0.99
    # Distance (natural logarithm) from a bound within which a noise is reported as at the bound; above the search's
    # tolerance of 0.02.
    noise_bound_ln: float = 0.05
    # Mean NIS per measured quantity outside which the noise is reported not to fit a take.
    plausible_nis: tuple[float, float] = (0.7, 1.4)
    # Share of the drive force at the front axle from which a measured wheel speed counts as a front wheel's.
    front_driven_share: float = 0.5


LIMITS = EstimateLimits()

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
    # Share of the turning that a steering must explain to be identified; clean drives 0.9 and more (tests/fleet.py).
    min_turning_explained: float = 0.8
    # Most takes that serve to identify the steering: more add little, and cost a second each.
    max_servo_takes: int = 3
    # Longest part (s) of each: a minute gives T_s to 3 % (docs/results/checks.json).
    servo_take_s: float = 60.0
    # Error of T_s (natural logarithm) that no scatter shows: tyres unlike the model's.  With this and the next all
    # of 54 takes are inside, among them the 1:10 car's 14 lively ones, of which 10 are without (seeds 31100, 40000).
    servo_systematic_ln: float = 0.01
    # Error of T_s in steps of the grid: the servo is followed from row to row, and small cars at 25 Hz come out low.
    servo_systematic_steps: float = 0.05
    # Error of d (natural logarithm) that no scatter shows: its angle is that of tyres with trim.  Of 20 takes of the
    # fleet that reach it 17 are inside without, 20 with 0.005 (seed 40000); one of 8 others needs more than 0.02.
    rate_systematic_ln: float = 0.01
    # Standard deviation (natural logarithm) beyond which a constant is not identified: the factor is not known.
    max_servo_sd_ln: float = 0.35
    # Nats by which a rate limit must explain the turning better than none: a likelihood ratio of 150.
    min_rate_nats: float = 5.0
    # Times the fastest rate of the steering, at which a limit that is never reached is put.
    unreached_rate_factor: float = 1.5
    # Distance (natural logarithm) from a bound within which a noise is reported as at the bound; above the search's
    # tolerance of 0.02.
    noise_bound_ln: float = 0.05
    # Mean NIS per measured quantity outside which the noise is reported not to fit a take.
    plausible_nis: tuple[float, float] = (0.7, 1.4)
    # Share of the drive force at the front axle from which a measured wheel speed counts as a front wheel's.
    front_driven_share: float = 0.5
    # Parts of a grid period in which commands may differ, beyond which they are averaged: 5 ms in the usual period of
    # 0.1 s, a quarter of the fastest servo (T_s of 0.02 s) that a vehicle file may hold.
    max_command_parts: int = 20
    # Share of what a grid from time zero loses of the commands' variance, below which a shifted grid is worth it: one
    # in step with the commands loses next to nothing, one against commands out of step about as much as any.
    shift_gain: float = 0.5
    # Share of the variance of commands within periods from which on it is told: below, what models are given is as good
    # as what was commanded.
    told_variance_lost: float = 0.01
    # Changes of the commands that are looked at for a shift: ten minutes of commands at 10 Hz, an hour's sample.
    shift_changes: int = 5000
    # Shifts that are tried: a regular clock's phase is among them to a hundredth of a period.
    shift_candidates: int = 200

    # Number of a segment in a saved estimate: no take has a billion.
    max_segment: int = 10**9
    # Shortest grid period (s): a thousandth is beyond any motion capture.
    min_period_s: float = 1e-3
    # Longest grid period (s): a second is beyond any controller.
    max_period_s: float = 1.0
    # Least noise (SI): below a nanometre there is no sensor, and the filter's matrices are singular.
    min_noise: float = 1e-9
    # Largest noise (SI): above a hundred kilometres per second there is no car.
    max_noise: float = 1e5
    # Least time constant (s) and rate limit (rad/s) of a servo in a saved tuning, far below those that are searched.
    min_steering: float = 1e-4
    # Largest of them, far above.
    max_steering: float = 1e4


LIMITS = EstimateLimits()

"""Limits of readers and checks: what of a recording is refused, left out, split, warned of or called a no-go.

"Row N" is a row of docs/recordings.md, which says what becomes of a clean drive that is damaged in one way. A comment
goes through the fields below it in their order; their units are in their names, ratios have none.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class TableLimits:
    """Limits on Motive exports and other tables."""

    # largest text, and longest Parquet table (half a day at 120 Hz), that fit into memory; not yet justified
    max_bytes: int = 1 << 30
    max_rows: int = 5_000_000
    # share of rows with as many cells, from which a row with fewer was never written whole (row 47)
    min_equal_length_share: float = 0.98
    # largest difference of time and frame number, in periods or by the digits of the Time column; not yet justified
    max_time_error_periods: float = 0.5
    max_time_error_s: float = 1.1e-3
    # marker errors: share of exact zeros, below which those poses were interpolated (row 10); error, and times the
    # usual one, beyond both of which a pose is no measurement (row 9: 80 mm)
    max_interpolated_share: float = 0.05
    max_marker_error_m: float = 0.005
    max_marker_error_factor: float = 5.0
    # angle that radians reach on both sides before they wrap, where Motive writes degrees (row 25)
    min_wrap_rad: float = 3.0


@dataclass(frozen=True)
class McapLimits:
    """Limits on MCAP files."""

    # largest record, expansion that is always allowed, and times a chunk may grow ("bombs" in docs/results/faults.json)
    max_record_bytes: int = 1 << 28
    free_expansion_bytes: int = 1 << 24
    max_expansion_factor: int = 300
    # a stamp is invalid a century ahead, and a zero where other stamps begin later than a clock's start (row 20)
    max_stamp_ns: float = float(1 << 62)
    min_unused_stamp_ns: float = 1e10
    # step of stamps against log times, from one message to the next, that is a clock jump (test_mcap_times: 3 s)
    max_clock_step_s: float = 0.1
    # bursts: steps below a share of the mean, and their share; steps by so much longer than nearly all part the even
    # grids on which arrivals are put, unless these lie too far off (row 19)
    crowded_step: float = 0.2
    min_crowded_share: float = 0.1
    burst_gap_factor: float = 1.5
    max_grid_error_s: float = 0.1
    # messages of a frame, and times as many of the body, that are a misspelt name (test_mcap_times: 1 of 200)
    max_rare_messages: int = 2
    min_rare_ratio: int = 50


@dataclass(frozen=True)
class StreamLimits:
    """Limits on the times and numbers of the pose and the command stream."""

    # share of rows without finite numbers (row 12: 10 % are refused); share with the stamp of another (test_legitimate)
    max_non_finite_share: float = 0.05
    max_shared_stamp_share: float = 0.2
    # larger values (m or rad) lie beyond the Earth, larger times beyond 3,000 years: other units; not yet justified
    max_value: float = 1e9
    max_time_s: float = 1e11
    # samples that may come late; more are a clock that was set back (row 15: 0.054 s is sorted, 0.304 s refused)
    max_late_samples: int = 10
    # fewest poses of a take, and the range of their rate if stamps are in seconds; not yet justified
    min_poses: int = 10
    min_rate_hz: float = 2.0
    max_rate_hz: float = 2000.0
    # longest take, in times its poses at their usual rate, plus a pause: else its clock jumped (row 16: 700 s are read)
    max_span_factor: float = 10.0
    max_span_excess_s: float = 600.0
    # a yaw in degrees turns faster than a car, over a time that averages noise, or steps by nearly 360 (row 25)
    max_yaw_rate_radps: float = 40.0
    yaw_rate_window_s: float = 0.05
    min_wrap_step: float = 350.0
    max_wrap_step: float = 370.0
    # usual steps that make a gap (row 18); share of shorter steps if commands are sent at a rate; not yet justified
    gap_steps: float = 1.5
    min_regular_share: float = 0.95


@dataclass(frozen=True)
class PoseLimits:
    """Limits between a tracking failure, or a car that is carried, and the motion of a car."""

    # error of a quaternion's length that is mended; share of worse ones, which are left out (row 2: 3 % are refused);
    # error that an export's digits make, and that is not noted
    max_length_error: float = 1e-3
    max_non_unit_share: float = 0.01
    rounding_length_error: float = 2e-5
    # cosine of the angle to the usual vertical of an upright body (20 degrees) and of one that is tipped over (45, row
    # 52); share of upright samples of a car on its wheels, and of quaternions in another order (row 3)
    upright_cosine: float = 0.94
    tipped_cosine: float = 0.7
    min_upright_share: float = 0.8
    max_leaning_share: float = 0.5
    # distance of a lifted body from the floor's plane, also in usual distances (row 52: 0.9 m); share of lifted samples
    # of a car that has a floor; height by way that a car can climb (test_legitimate: a hill and a ramp)
    lifted_m: float = 0.05
    lifted_factor: float = 10.0
    max_lifted_share: float = 0.5
    max_climb: float = 0.7
    # motion along the true vertical by motion along the stated one, and the least of the latter that shows it (row 24)
    max_vertical_share: float = 0.25
    min_drive_m: float = 0.5
    # samples for which each pose is repeated in a table with its own rate (test_legitimate: 3, 6 and 12)
    min_held_samples: float = 2.0
    # time for which a pose repeats under throttle (row 8: 0.4 s is frozen); usual steps by which it then goes on if the
    # car stood at a wall, and was not hidden (test_legitimate)
    max_repeat_s: float = 0.25
    max_resume_steps: float = 2.0
    # angle about half a turn, and usual steps over which the car cannot have turned, of a flip (row 4); share of a long
    # step that shows where the car goes
    flip_tolerance_rad: float = 0.2
    max_flip_steps: float = 3.0
    min_heading_step: float = 0.2
    # fastest car where the vehicle file states none; share of jumps, beyond which the unit is wrong (row 22)
    max_speed_mps: float = 100.0
    max_jump_share: float = 0.05
    # how much faster a jump is than the steps around it: times, by a speed, by times their noise (row 5), and by an
    # acceleration that neither tyres nor a contact make (test_legitimate: hard starts at 5 Hz are no jumps)
    jump_factor: float = 3.0
    jump_speed_mps: float = 2.0
    jump_noise_factor: float = 10.0
    jump_acceleration_mps2: float = 60.0
    # longest stretch between two jumps that is nothing but outliers (row 39: one digit changed)
    max_outlier_s: float = 0.1
    # wheelbases within which a ghost stays, for how long at least, and the share of that under throttle (row 5)
    ghost_size: float = 0.1
    min_ghost_s: float = 0.5
    min_driven_share: float = 0.8
    # two sources alternate: distance of the second next sample by that of the next; share of large steps of which this
    # holds; share of large steps (row 32)
    alternating_distance: float = 0.5
    min_alternating_share: float = 0.7
    min_moving_share: float = 0.3
    # one driver changes commands more slowly than this, or between so many levels (test_legitimate: a slalom)
    min_driver_step_s: float = 0.08
    max_driver_levels: int = 8


@dataclass(frozen=True)
class MotionLimits:
    """Limits on what the motion shows of units, signs, clocks, the mounting of the body, and contacts."""

    # nominal periods between two poses, beyond which the motion there is not known; not yet justified
    max_gap_periods: float = 2.5
    # steering by the car's largest angle, and share of commands beyond that: else degrees; throttle by the largest
    # reference speed: else percent (row 25); a brake share is -1 or more (errata 13), but for rounding
    max_steering_factor: float = 3.0
    max_clipped_share: float = 0.5
    max_throttle_factor: float = 3.0
    min_brake_share: float = -1.05
    # speed by the motor's largest, beyond which there is a warning (row 23: lengths x 2); speed, or wheelbase by the
    # stated one or its inverse, beyond which the unit is another (row 22: lengths x 10)
    max_speed_factor: float = 1.2
    max_scale_factor: float = 4.0
    # turning is judged in rows at this share of the top speed, so many, with this yaw rate and commanded turning (by
    # the top speed) at least (row 51: not on a straight line); the wheelbase also in gentle driving
    min_speed_share: float = 0.1
    min_turning_rows: int = 100
    min_yaw_rate_radps: float = 1e-3
    min_commanded_turn: float = 0.02
    gentle_lateral_mps2: float = 3.0
    # correlation of turning and steering; agreement of their directions, and that if an axis is mirrored (rows 24, 26)
    min_turning_correlation: float = 0.5
    min_heading_agreement: float = 0.6
    min_mirrored_agreement: float = 0.8
    # a channel and the motion: correlation, factor in another unit (rows 25, 26), rows compared, and delay
    min_channel_correlation: float = 0.7
    max_channel_factor: float = 3.0
    min_channel_rows: int = 200
    max_channel_delay_s: float = 0.5
    # blocks that give a delay each: length, number, largest delay tried; share of the yaw acceleration that commands
    # explain; speed of the rows used; sure offset that is warned of (test_readers: 0.05 s; test_doubtful_poses: 0.08 s)
    clock_block_s: float = 10.0
    min_clock_blocks: int = 4
    max_clock_delay_s: float = 0.3
    min_explained_share: float = 0.5
    min_clock_speed_mps: float = 0.3
    max_clock_offset_s: float = 0.005
    # blocks that give a yaw offset each: length, number, share of rows used; share of the top speed, acceleration and,
    # in a first guess, yaw rate of these rows; sure offset that is warned of, since tyres slip less (test_health)
    mounting_block_s: float = 5.0
    min_mounting_blocks: int = 6
    min_mounting_block_share: float = 0.1
    min_mounting_speed_share: float = 0.3
    max_mounting_lateral_mps2: float = 0.3
    max_mounting_yaw_rate_radps: float = 0.2
    max_yaw_offset_rad: float = 0.03
    # a contact: sudden change of velocity (test_health: 1.2 m/s); acceleration that small cars' tyres give, and times
    # that of nearly all the take; time within which hits are one; a crash: time for which the car then stays, and way
    contact_velocity_mps: float = 0.4
    max_tyre_mps2: float = 3.0
    contact_usual_factor: float = 2.0
    contact_merge_s: float = 0.5
    crash_stop_s: float = 1.0
    crash_stop_m: float = 0.05


@dataclass(frozen=True)
class HealthLimits:
    """Limits between a take that is worth fitting and one to drive again."""

    # wheelbases per second of a moving car, and its shortest motion: twenty stretches of 1.5 s; not yet justified
    min_moving_speed: float = 0.1
    min_motion_s: float = 30.0
    # share of the take in which the pose is known, and in which a command is (test_health: a third is too little)
    min_coverage: float = 0.8
    # steering or lateral acceleration that shows tyres and inertia (test_health: a straight line does not)
    min_steering_rad: float = 0.1
    min_lateral_mps2: float = 0.5
    # spread of speeds by the fastest that tells motor and drag apart; braking that shows the brake (test_health: not in
    # one circle)
    min_speed_spread: float = 0.3
    min_braking_s: float = 2.0
    # clock offset beyond the vehicle file's that is listed; not yet justified
    max_clock_offset_s: float = 0.1


TABLE, MCAP = TableLimits(), McapLimits()
STREAM, POSE, MOTION, HEALTH = StreamLimits(), PoseLimits(), MotionLimits(), HealthLimits()

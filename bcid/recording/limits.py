"""Limits of readers and checks: what of a recording is refused, left out, split, warned of or called a no-go.

"Row N" is a row of docs/recordings.md, which says what becomes of a clean drive that is damaged in one way.  Units
are in the fields' names; ratios have none.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class TableLimits:
    """Limits on Motive exports and other tables."""

    # largest text that fits into memory; not yet justified
    max_bytes: int = 1 << 30
    # longest Parquet table that fits into memory, half a day at 120 Hz; not yet justified
    max_rows: int = 5_000_000
    # share of rows with as many cells, from which a row with fewer was never written whole (row 47)
    min_equal_length_share: float = 0.98
    # largest difference of time and frame number; not yet justified
    max_time_error_periods: float = 0.5
    # difference of both by the digits of the Time column, that is allowed, too; not yet justified
    max_time_error_s: float = 1.1e-3
    # share of marker errors of exactly zero, below which those poses were interpolated (row 10)
    max_interpolated_share: float = 0.05
    # marker error that a pose which is no measurement passes (row 9: 80 mm)
    max_marker_error_m: float = 0.005
    # times the usual marker error, which a pose that is no measurement also passes (row 9)
    max_marker_error_factor: float = 5.0
    # angle that radians reach on both sides before they wrap, where Motive writes degrees (row 25)
    min_wrap_rad: float = 3.0


@dataclass(frozen=True)
class McapLimits:
    """Limits on MCAP files."""

    # largest record ("bombs" in docs/results/faults.json)
    max_record_bytes: int = 1 << 28
    # size that a chunk may always grow to ("bombs" in docs/results/faults.json)
    free_expansion_bytes: int = 1 << 24
    # times a larger chunk may grow ("bombs" in docs/results/faults.json)
    max_expansion_factor: int = 300
    # a stamp a century ahead is invalid (row 20)
    max_stamp_ns: float = float(1 << 62)
    # a stamp of zero is invalid where the others begin later than a clock's start (row 20)
    min_unused_stamp_ns: float = 1e10
    # step of stamps against log times, from one message to the next, that is a clock jump (test_mcap_times: 3 s)
    max_clock_step_s: float = 0.1
    # steps of a burst: below this share of the mean (row 19)
    crowded_step: float = 0.2
    # share of such steps from which messages come in bursts (row 19)
    min_crowded_share: float = 0.1
    # times nearly all steps, from which a step parts the even grids that arrivals are put on (row 19)
    burst_gap_factor: float = 1.5
    # distance of an arrival from its even grid beyond which all stay as they are (row 19)
    max_grid_error_s: float = 0.1
    # most messages of a frame whose name is misspelt (test_mcap_times: 1 of 200)
    max_rare_messages: int = 2
    # times as many messages of the body, from which that name is misspelt (test_mcap_times: 1 of 200)
    min_rare_ratio: int = 50


@dataclass(frozen=True)
class StreamLimits:
    """Limits on the times and numbers of the pose and the command stream."""

    # share of rows without finite numbers (row 12: 10 % are refused)
    max_non_finite_share: float = 0.05
    # share of rows with the stamp of another (test_legitimate)
    max_shared_stamp_share: float = 0.2
    # larger values (m or rad) lie beyond the Earth: another unit; not yet justified
    max_value: float = 1e9
    # larger times lie beyond 3,000 years: another unit; not yet justified
    max_time_s: float = 1e11
    # samples that may come late; more are a clock that was set back (row 15: 0.054 s is sorted, 0.304 s refused)
    max_late_samples: int = 10
    # fewest poses of a take; not yet justified
    min_poses: int = 10
    # lowest rate of poses whose stamps are in seconds; not yet justified
    min_rate_hz: float = 2.0
    # highest rate of poses whose stamps are in seconds; not yet justified
    max_rate_hz: float = 2000.0
    # longest take, in times its poses at their usual rate: else its clock jumped (row 16: 700 s are read)
    max_span_factor: float = 10.0
    # pause that such a take may have in addition (row 16)
    max_span_excess_s: float = 600.0
    # faster than any car turns: such a yaw is in degrees (row 25)
    max_yaw_rate_radps: float = 40.0
    # time over which that yaw rate is averaged, so that noise does not reach it (row 25)
    yaw_rate_window_s: float = 0.05
    # smallest step at which a yaw in degrees wraps (row 25)
    min_wrap_step: float = 350.0
    # largest step at which a yaw in degrees wraps (row 25)
    max_wrap_step: float = 370.0
    # usual steps that make a gap (row 18)
    gap_steps: float = 1.5
    # share of shorter steps from which commands are sent at a rate; not yet justified
    min_regular_share: float = 0.95


@dataclass(frozen=True)
class PoseLimits:
    """Limits between a tracking failure, or a car that is carried, and the motion of a car."""

    # error of a quaternion's length up to which it is mended (row 2)
    max_length_error: float = 1e-3
    # share of worse quaternions, up to which these are left out (row 2: 3 % are refused)
    max_non_unit_share: float = 0.01
    # error that an export's digits make, and that is not noted (row 2)
    rounding_length_error: float = 2e-5
    # cosine of the angle to the usual vertical, above which a body is upright: 20 degrees (row 52)
    upright_cosine: float = 0.94
    # cosine of that angle, below which a body is tipped over: 45 degrees (row 52)
    tipped_cosine: float = 0.7
    # share of upright samples from which a car is on its wheels (row 52)
    min_upright_share: float = 0.8
    # share of upright samples below which another order of the quaternion is tried (row 3)
    max_leaning_share: float = 0.5
    # distance of a lifted body from the floor's plane (row 52: 0.9 m)
    lifted_m: float = 0.05
    # usual distances from that plane, which a lifted body also passes (row 52)
    lifted_factor: float = 10.0
    # share of lifted samples below which a car has a floor (test_legitimate)
    max_lifted_share: float = 0.5
    # height by way that a car can climb (test_legitimate: a hill and a ramp)
    max_climb: float = 0.7
    # motion along the true vertical by motion along the stated one, below which the axis is wrong (row 24)
    max_vertical_share: float = 0.25
    # least motion along the stated vertical that shows it (row 24)
    min_drive_m: float = 0.5
    # samples for which each pose is repeated in a table with its own rate (test_legitimate: 3, 6 and 12)
    min_held_samples: float = 2.0
    # time for which a pose repeats under throttle (row 8: 0.4 s is frozen)
    max_repeat_s: float = 0.25
    # usual steps up to which a pose moves on if the car stood at a wall and was not hidden (test_legitimate)
    max_resume_steps: float = 2.0
    # distance from half a turn within which a turn is a flip (row 4)
    flip_tolerance_rad: float = 0.2
    # usual steps over which a car cannot have turned so far (row 4)
    max_flip_steps: float = 3.0
    # share of a long step above which a step shows where the car goes (row 4)
    min_heading_step: float = 0.2
    # fastest car where the vehicle file states none; not yet justified
    max_speed_mps: float = 100.0
    # share of jumps beyond which the unit is wrong (row 22)
    max_jump_share: float = 0.05
    # times the speed around a step, which a jump passes (row 5)
    jump_factor: float = 3.0
    # least speed of a jump, where the speed around it is low (row 5)
    jump_speed_mps: float = 2.0
    # times the noise of the speed, which is added to what a jump has to pass (row 5)
    jump_noise_factor: float = 10.0
    # more than tyres and contacts make: least acceleration of a jump (test_legitimate: hard starts at 5 Hz)
    jump_acceleration_mps2: float = 60.0
    # longest stretch between two jumps that is nothing but outliers (row 39: one digit changed)
    max_outlier_s: float = 0.1
    # wheelbases within which a ghost stays (row 5)
    ghost_size: float = 0.1
    # shortest time for which a ghost stays there (row 5)
    min_ghost_s: float = 0.5
    # share of that time under throttle, from which a car would have moved (row 5)
    min_driven_share: float = 0.8
    # distance of the second next sample by that of the next, below which two sources alternate (row 32)
    alternating_distance: float = 0.5
    # share of large steps that must alternate (row 32)
    min_alternating_share: float = 0.7
    # share of steps that must be large (row 32)
    min_moving_share: float = 0.3
    # usual time between commands below which many levels are no driver's (test_legitimate: a slalom)
    min_driver_step_s: float = 0.08
    # levels of a command that one driver may give so fast (test_legitimate: a slalom)
    max_driver_levels: int = 8


@dataclass(frozen=True)
class MotionLimits:
    """Limits on what the motion shows of units, signs, clocks, the mounting of the body, and contacts."""

    # nominal periods between two poses, beyond which the motion there is not known; not yet justified
    max_gap_periods: float = 2.5
    # largest commands by the car's largest angle, beyond which they are in degrees (row 25)
    max_steering_factor: float = 3.0
    # share of commands beyond the car's largest angle, from which they are in degrees (row 25)
    max_clipped_share: float = 0.5
    # largest throttle by the largest reference speed, beyond which it is in percent (row 25)
    max_throttle_factor: float = 3.0
    # a brake share is -1 or more (errata 13), but for rounding
    min_brake_share: float = -1.05
    # speed by the motor's largest, beyond which there is a warning (row 23: lengths x 2)
    max_speed_factor: float = 1.2
    # speed by the motor's largest, or wheelbase by the stated one or its inverse, of another unit (row 22)
    max_scale_factor: float = 4.0
    # share of the top speed from which rows judge turning (row 51)
    min_speed_share: float = 0.1
    # fewest rows that judge turning (row 51)
    min_turning_rows: int = 100
    # least yaw rate that judges turning (row 51: not on a straight line)
    min_yaw_rate_radps: float = 1e-3
    # least commanded turning by the top speed, to judge turning (row 51: not on a straight line)
    min_commanded_turn: float = 0.02
    # lateral acceleration of gentle driving, in which the wheelbase is also judged; not yet justified
    gentle_lateral_mps2: float = 3.0
    # least correlation of turning and steering (rows 24, 26)
    min_turning_correlation: float = 0.5
    # least agreement of the directions of turning and steering (rows 24, 26)
    min_heading_agreement: float = 0.6
    # agreement of the directions if an axis is mirrored, from which it is (rows 24, 26)
    min_mirrored_agreement: float = 0.8
    # least correlation of a recorded channel and the motion (rows 25, 26)
    min_channel_correlation: float = 0.7
    # factor, or its inverse, by which a channel in another unit differs (rows 25, 26)
    max_channel_factor: float = 3.0
    # fewest rows of a channel that are compared; not yet justified
    min_channel_rows: int = 200
    # largest delay of a channel that is tried; not yet justified
    max_channel_delay_s: float = 0.5
    # length of the blocks that give a clock delay each; not yet justified
    clock_block_s: float = 10.0
    # fewest blocks that give a clock delay; not yet justified
    min_clock_blocks: int = 4
    # largest clock delay that is tried; not yet justified
    max_clock_delay_s: float = 0.3
    # share of the yaw acceleration that commands must explain for a clock delay; not yet justified
    min_explained_share: float = 0.5
    # least speed of rows that give a clock delay; not yet justified
    min_clock_speed_mps: float = 0.3
    # sure clock offset that is warned of (test_readers: 0.05 s; test_doubtful_poses: 0.08 s)
    max_clock_offset_s: float = 0.005
    # length of the blocks that give a yaw offset each; not yet justified
    mounting_block_s: float = 5.0
    # fewest blocks that give a yaw offset; not yet justified
    min_mounting_blocks: int = 6
    # share of a block's rows that must give its yaw offset; not yet justified
    min_mounting_block_share: float = 0.1
    # share of the top speed, above which rows give a yaw offset; not yet justified
    min_mounting_speed_share: float = 0.3
    # lateral acceleration up to which rows give a yaw offset; not yet justified
    max_mounting_lateral_mps2: float = 0.3
    # yaw rate up to which rows give a first guess of the yaw offset; not yet justified
    max_mounting_yaw_rate_radps: float = 0.2
    # sure yaw offset that is warned of, since tyres slip less (test_health)
    max_yaw_offset_rad: float = 0.03
    # sudden change of velocity in a contact (test_health: 1.2 m/s)
    contact_velocity_mps: float = 0.4
    # acceleration that small cars' tyres give; not yet justified
    max_tyre_mps2: float = 3.0
    # times the acceleration of nearly all the take, which a contact passes; not yet justified
    contact_usual_factor: float = 2.0
    # time within which hits are one contact; not yet justified
    contact_merge_s: float = 0.5
    # time for which a car stays after a crash; not yet justified
    crash_stop_s: float = 1.0
    # way within which a car stays after a crash; not yet justified
    crash_stop_m: float = 0.05


@dataclass(frozen=True)
class HealthLimits:
    """Limits between a take that is worth fitting and one to drive again."""

    # wheelbases per second of a moving car; not yet justified
    min_moving_speed: float = 0.1
    # shortest motion: twenty stretches of 1.5 s; not yet justified
    min_motion_s: float = 30.0
    # share of the take in which the pose is known, and in which a command is (test_health: a third is too little)
    min_coverage: float = 0.8
    # steering that shows tyres and inertia (test_health: a straight line does not)
    min_steering_rad: float = 0.1
    # lateral acceleration that shows tyres and inertia (test_health: a straight line does not)
    min_lateral_mps2: float = 0.5
    # spread of speeds by the fastest that tells motor and drag apart (test_health: not in one circle)
    min_speed_spread: float = 0.3
    # braking that shows the brake (test_health: not in one circle)
    min_braking_s: float = 2.0
    # clock offset beyond the vehicle file's that is listed; not yet justified
    max_clock_offset_s: float = 0.1


TABLE, MCAP = TableLimits(), McapLimits()
STREAM, POSE, MOTION, HEALTH = StreamLimits(), PoseLimits(), MotionLimits(), HealthLimits()

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
    # most columns: what spreadsheets hold, and five times what an export of fifty bodies with markers has
    max_columns: int = 16_384
    # longest text that may be a number or a stamp: a date with its zone has 35, a pair in a cell some 60
    max_cell_bytes: int = 200
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
class StampLimits:
    """Limits on the stamps of tables, in whatever notation."""

    # Unix time in September 2001: recordings are younger; seconds since a start are far smaller
    min_unix_s: float = 1e9
    # Unix time in 2099; a thousandfold of it, and so a count of ms, is no time in seconds of this age
    max_unix_s: float = 4.1e9
    # pause within which a clock that is set back by a day or an hour has passed midnight, or the end of summer time
    max_wrap_pause_s: float = 60.0


@dataclass(frozen=True)
class McapLimits:
    """Limits on MCAP files."""

    # largest record ("bombs" in docs/results/faults.json)
    max_record_bytes: int = 1 << 27
    # largest record that is no chunk, message or attachment: the counts of 65,536 channels take 0.7 MiB (test_mcap)
    max_declaration_bytes: int = 1 << 22
    # size that a chunk may always grow to ("bombs" in docs/results/faults.json)
    free_expansion_bytes: int = 1 << 24
    # times a larger chunk may grow ("bombs" in docs/results/faults.json)
    max_expansion_factor: int = 300
    # messages that any file may hold; more than its bytes are no recording (test_mcap: 4 million in 0.5 MB)
    free_messages: int = 1 << 16
    # messages that are read of the wanted topics: 2.4 h of poses at 120 Hz, in about 1 GiB (test_broken_messages)
    max_messages: int = 1 << 20
    # bytes of these messages, which are held until they are decoded (test_broken_messages)
    max_content_bytes: int = 1 << 28
    # bytes of these messages that any file may hold: 20 minutes of poses in JSON (test_broken_messages)
    free_content_bytes: int = 1 << 25
    # times its size that a larger file may hold of them: real ones, whose numbers are noisy, hold 3 (a car at rest: 20)
    max_content_factor: int = 30
    # a stamp a century ahead is invalid (row 20)
    max_stamp_ns: float = float(1 << 62)
    # a plain number is a date in the smallest unit that puts it after March 1973 (row 71: s, ms, µs, ns)
    min_dated_ns: float = 1e17
    # span of stamps by that of log times, or its inverse, in the right unit: units are 1000 apart (test_message_stamps)
    max_span_ratio: float = 3.0
    # larger numbers are no time in any unit: years in ns (test_message_stamps: 1e400)
    max_plain_stamp: float = 1e30
    # a stamp of zero is invalid where the others begin later than a clock's start (row 20)
    min_unused_stamp_ns: float = 1e10
    # step of stamps against log times, from one message to the next, that is a clock jump (test_mcap_times: 3 s)
    max_clock_step_s: float = 0.1
    # steps of a burst: below this share of the mean (row 19)
    crowded_step: float = 0.2
    # share of such steps from which messages come in bursts (row 19)
    min_crowded_share: float = 0.1
    # fewest steps that show bursts: some seconds of poses (test_mcap_times)
    min_burst_steps: int = 20
    # messages over which their period is measured: longer than any burst (row 72)
    burst_window: int = 200
    # share by which the period is taken shorter, so that its error shifts nothing (test_mcap_times)
    period_margin: float = 1e-3
    # lateness of an arrival beyond which all stay as they are: longer than a network stalls (row 72: 0.4 s)
    max_late_s: float = 1.0
    # difference of a step from the period, in which sending is even (row 72)
    max_uneven_step: float = 0.2
    # share of even steps from which arrivals are put back to them (row 72; 2 % of the messages may be lost)
    min_even_share: float = 0.9
    # most messages of a frame whose name is misspelt (test_mcap_times: 1 of 200)
    max_rare_messages: int = 2
    # times as many messages of the body, from which that name is misspelt (test_mcap_times: 1 of 200)
    min_rare_ratio: int = 50


@dataclass(frozen=True)
class MessageLimits:
    """Limits on single messages and their definitions, checked before anything is built of them."""

    # longest message of a pose or command: 2,000 bodies of 128 bytes (test_broken_messages: a bomb is refused)
    max_message_bytes: int = 1 << 18
    # items of all lists in one message: more than any tracking system has bodies (test_broken_messages)
    max_list_items: int = 10_000
    # longest definition of a type: 50 times nav_msgs/Odometry's with all that it uses (test_broken_messages)
    max_definition_bytes: int = 1 << 18
    # types in a definition: 20 times those of nav_msgs/Odometry (test_broken_messages)
    max_definition_types: int = 200
    # types nested in each other: 6 times as deep as nav_msgs/Odometry's (test_broken_messages)
    max_definition_depth: int = 30
    # longest metadata.yaml: some 10,000 parts of a split bag; the parser reads no further (test_rosbag)
    max_metadata_bytes: int = 1 << 20


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
    # samples between a time and the one that it is set back to, by those of one clock: samples that only came late are
    # as many, of a clock that was set back twice as many (row 15)
    min_doubled: float = 1.5
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
    # samples whose median such a rate is taken of: two wrong ones next to each other do not enter it (row 61)
    yaw_filter_samples: int = 5
    # smallest step at which a yaw in degrees wraps (row 25)
    min_wrap_step: float = 350.0
    # largest step at which a yaw in degrees wraps (row 25)
    max_wrap_step: float = 370.0
    # median steps beyond which a step is a gap, not one of two that follow in turn (test_held: 1.2 samples held)
    max_usual_steps: float = 2.5
    # usual steps that make a gap (row 18)
    gap_steps: float = 1.5
    # share of shorter steps from which commands are sent at a rate; not yet justified
    min_regular_share: float = 0.95


@dataclass(frozen=True)
class LostLimits:
    """Limits between a pose and a placeholder that stands for a body which was not seen."""

    # times the usual step, above which a step is a jump to a placeholder: no car speeds up tenfold in one sample
    step_factor: float = 10.0
    # fewest rows that show a usual step
    min_rows: int = 5


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
    # level part of the body's X axis above which it is level: leaning by 6 degrees, a tenth of the roll is seen as yaw
    level_cosine: float = 0.995
    # level part below which the X axis points up: its yaw would be known ten times worse than the vertical (row 65)
    min_level_part: float = 0.1
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
    # mean samples for which each pose is repeated in a table with its own rate (test_held: 1.2, 3, 6 and 12)
    min_held_samples: float = 1.1
    # share of the repetitions that such a table makes evenly; the car stands, or the tracking fails, in the others
    regular_quantile: float = 0.95
    # different changes of a column by all its changes, below which it is written in coarse digits (test_held)
    max_coarse_share: float = 0.2
    # share of one and the same change in a column, from which it is a steady motion and no digit (test_held)
    min_steady_share: float = 0.99
    # low quantile of a column's changes, which is its digit: single ones may be finer (test_held)
    digit_quantile: float = 0.01
    # digits that a pose may move on by after repeats that the rounding made: one, and one by it again (test_held)
    max_digits: float = 3.5
    # noises that it may move on by besides (test_held)
    max_digit_noises: float = 6.0
    # quantile of the steps in motion that is a usual one, above starts and stops; not yet justified
    usual_quantile: float = 0.9
    # time from which repeats are judged by where the car goes on, and told where it stood under throttle (row 8)
    max_repeat_s: float = 0.25
    # usual steps up to which a pose moves on if the car stood at a wall and was not hidden (test_legitimate)
    max_resume_steps: float = 2.0
    # usual steps below which a car is about to stand (test_held: a car that stops, seen without noise)
    max_rest_step: float = 0.3
    # next steps up to which the first one is long if a car starts from rest: it is the shorter one (test_held)
    max_start_steps: float = 1.5
    # share of a take above which one yaw throughout is not held, but none (row 63)
    max_held_yaw_share: float = 0.9
    # turn of the path during which a yaw cannot stay to the last digit: more than tyres slip (row 63)
    min_path_turn_rad: float = 0.4
    # usual steps, beyond which a pose that is then held was jumped to (row 5: a held pose 3 m away)
    max_step_to_held: float = 5.0
    # noises, and digits, of the position by which such a path must go on (row 63)
    min_path_noises: float = 10.0
    # fastest car where the vehicle file states none; not yet justified
    max_speed_mps: float = 100.0
    # share of jumps beyond which the unit is wrong (row 22)
    max_jump_share: float = 0.05
    # times the speed around a step, which a jump passes (row 5)
    jump_factor: float = 3.0
    # least speed of a jump, where the speed around it is low (row 5)
    jump_speed_mps: float = 2.0
    # times the noise of the speed, which is added to what a jump has to pass (test_heading: heavy noise)
    jump_noise_factor: float = 20.0
    # more than tyres and contacts make: least acceleration of a jump (test_legitimate: hard starts at 5 Hz)
    jump_acceleration_mps2: float = 60.0
    # share of a jump that is left after the jump back (row 5: another body for 2 s)
    max_return_share: float = 0.25
    # share of the poses beside an excursion that it may have itself: the car is where it is for longer (row 5)
    max_excursion_share: float = 0.5
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
    # correlation of a step of time with the second next, from which two clocks send by turns: of one clock with jitter
    # it is 0, of two almost 1 (row 32, test_legitimate: a chattering controller)
    min_turn_correlation: float = 0.5
    # spread of the steps by their mean, which two clocks make unless they beat in step (row 32)
    min_turn_spread: float = 0.05


@dataclass(frozen=True)
class HeadingLimits:
    """Limits between a car that turns and a yaw that jumps."""

    # smallest jump, two degrees: tyres slip as much, so that a smaller one hardly shows (row 62: 0.12 rad)
    min_jump_rad: float = 0.03
    # times the noise of a step, which a jump passes (test_heading: clean drives)
    jump_noise_factor: float = 7.0
    # digits of a rounded yaw, which a jump passes: two neighbouring samples that are rounded apart (test_heading)
    jump_digits: float = 2.0
    # share of what a jump passes, from which another step is the way back (test_heading: heavy noise)
    return_share: float = 0.5
    # share of a jump by which the way back may differ from it (test_heading: heavy noise)
    max_return_misfit: float = 0.25
    # 2 mu g of tyres on carpet with mu = 1.5: yaw acceleration by the wheelbase (test_heading: clean drives)
    max_grip_mps2: float = 30.0
    # faster than any car spins; half of what would be degrees (test_heading: spins of 10 rad/s)
    max_yaw_rate_radps: float = 25.0
    # slacks of a jump, within which the next one leads back to a level: two jumps and the noise of both
    same_level_slacks: float = 2.0
    # share of jumps beyond which it is no rare failure (row 61: spikes in 10 % of the samples)
    max_jump_share: float = 0.05
    # distance from half a turn within which a turn is a flip (row 4)
    flip_tolerance_rad: float = 0.2
    # usual steps over which a car cannot have turned so far (row 4)
    max_flip_steps: float = 3.0
    # 2 mu g of most tyres, by which a car turns in a gap; its path shows a jump besides (test_heading: clean drives)
    gap_grip_mps2: float = 15.0
    # smallest jump over a gap, beyond what the car turns: lines through noisy poses meet no better (test_heading)
    min_gap_jump_rad: float = 0.15
    # distance from a full turn within which a wrapped yaw was joined: what a car turns meanwhile (row 64)
    wrap_tolerance_rad: float = 1.0
    # time for which a changed mounting stays at a take's end; shorter ones are outliers (row 61)
    min_mounting_s: float = 0.5
    # share of a yaw's jump by which yaw and path may part where both turn: half, where the position jumps (f1tenth_ini)
    max_turn_share_at_leap: float = 0.5
    # that share where the position does not jump, as markers are knocked more often than axes are set anew (row 62)
    max_turn_share: float = 0.25
    # share of the longest mounting's samples, from which another may be the right one (row 4: a third)
    min_mounting_share: float = 0.1
    # by which another mounting's yaw must fit better: more than tyres slip and the lever of the body makes (row 62)
    max_misfit_rad: float = 0.15
    # share of a long step above which a step shows where the car goes (row 4)
    min_heading_step: float = 0.2


@dataclass(frozen=True)
class MotionLimits:
    """Limits on what the motion shows of units, signs, clocks, the mounting of the body, and contacts."""

    # nominal periods between two poses, beyond which the motion there is not known; not yet justified
    max_gap_periods: float = 2.5
    # largest commands by the car's largest angle, beyond which they are in degrees (row 25)
    max_steering_factor: float = 3.0
    # commands up to a quarter turn may be what a planner asks beyond the stop, however small that is (row 74)
    min_degrees: float = 1.6
    # no planner asks a car to steer by half a turn, whatever its stop; in degrees a drive soon does (row 25)
    max_asked_steering_rad: float = 3.2
    # rounding of a command in single precision, whose digits are 1.2e-7 apart (row 74: full lock)
    max_rounding: float = 1e-6
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
    # difference of two agreements that tells nothing (test_legitimate: mirrored axes)
    same_agreement: float = 0.05
    # least correlation of a recorded channel and the motion (rows 25, 26)
    min_channel_correlation: float = 0.7
    # factor, or its inverse, by which a channel in another unit differs (rows 25, 26)
    max_channel_factor: float = 3.0
    # fewest rows of a channel that are compared; not yet justified
    min_channel_rows: int = 200
    # largest delay of a channel that is tried; not yet justified
    max_channel_delay_s: float = 0.5
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
    # noises of positions beyond which one is no part of a path that accelerates (test_heading: heavy noise)
    outlier_noise_factor: float = 6.0
    # share of its distance by which its neighbours seem to lie on the other side: a half, without noise (test_heading)
    min_outlier_echo: float = 0.25
    # step of the path at one velocity that is a knocked marker: the body is known to some mm (row 62: 13 mm)
    min_mounting_step_m: float = 0.005
    # times the noise of positions, which such a step passes: the lines beside it are known to one noise (test_heading)
    mounting_noise_factor: float = 4.0
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
class ServoLimits:
    """Limits of the fit of servo and delay to how a car turns (`checks/steering_fit`)."""

    # fewest rows that are fitted: five seconds at 20 Hz say nothing of twelve constants
    min_rows: int = 100
    # longest differentiating filter: a model's step of 0.1 s is still seen behind it
    max_filter_s: float = 0.3
    # noise of speed and yaw rate that is let through, as share of their usual size: below what models leave
    noise_share: float = 0.03
    # share of the top speed below which the car is put back: slip angles mean nothing there
    min_speed_share: float = 0.1
    # time after which the car is put back to its measured motion, so that nothing can run away
    stretch_s: float = 6.0
    # time that tyres need to forget where they began: several times v / c for small and large cars
    settle_s: float = 0.6
    # length of the blocks whose scores give the covariance: longer than servo, tyres and floor remember
    block_s: float = 1.5
    # usual residuals from which one weighs less: Huber's constant is 1.3, but tyres are not the model's
    outlier: float = 2.5
    # error of a lag by the grid, in steps of it (tests/fleet.py: 1 ms at 100 Hz)
    systematic_steps: float = 0.2
    # error of a delay by a stated time constant: tyres and floor unlike the model's.  With 0.05 39 of 40 offsets of
    # the fleet are inside, but one of 100 exact clocks is called off (seeds 40000, 52000); with 0.15 none, and all
    # intervals hold (20000).  Set after these were seen
    systematic_share: float = 0.10
    # error of a delay by a time constant that is fitted, too: more by as much, as a real servo is not of first order
    systematic_share_fitted: float = 0.16
    # shortest lag that counts so: that of a fast servo
    least_lag_s: float = 0.06


@dataclass(frozen=True)
class ClockLimits:
    """Limits on the offset and drift of the command clock."""

    # the liveliest part of a take that is fitted: 50 s give a delay to some ms
    fitted_s: float = 50.0
    # share of the yaw rate that the fit must explain to tell a delay: clean drives 0.9 and more
    min_explained_share: float = 0.6
    # standard deviation of an offset, beyond which it is not told
    max_sd_s: float = 0.15
    # length of the blocks that give a delay each
    block_s: float = 10.0
    # fewest blocks that give a drift
    min_blocks: int = 5
    # information of a block by the usual one, from which it gives a delay
    min_block_share: float = 0.2
    # sure clock offset that is warned of (test_readers: 0.05 s; test_doubtful_poses: 0.08 s)
    max_offset_s: float = 0.005
    # nats by which an offset must explain the turning better than none: where a drive hardly tells delay and servo
    # apart, the fit may end at another minimum, whose interval knows nothing of the first (tests/fleet.py: 2.7)
    offset_nats: float = 5.0
    # sure drift by the end of a take that is warned of
    max_drift_s: float = 0.02
    # sure offset with which no model can be fitted: two of the models' periods
    max_usable_s: float = 0.2
    # longest dead time of a steering that is not known: what a radio, a planner and a gear box add up to
    longest_dead_time_s: float = 0.3


@dataclass(frozen=True)
class AgreementLimits:
    """Limits between commands that a car was driven by and any others (tests/fleet.py, docs/results/checks.json)."""

    # lags that are looked at on either side: a quarter of an hour at 25 Hz, with nulls enough; a lag takes 0.8 kB
    max_lags: int = 22_500
    # wheels that turn further may pull the car backward while they roll forward: the sign of its motion says nothing
    max_reversing_angle_rad: float = 1.3
    # share of a drive backward, from which the body may as well be mounted so
    max_backward_share: float = 0.9
    # length of the filter of the acceleration: longer than a motor's lag, shorter than a driver holds a throttle
    pull_window_s: float = 0.5
    # a steering command that varies by less is one and the same: below any servo's play
    least_steering_rad: float = 2e-3
    # turning (rad of steering, beyond one constant angle) below which nothing is told by it
    least_turning: float = 0.02
    # turning from which a car does not steer by one constant angle: more than trim and a sloping floor
    least_answered: float = 0.05
    # commands that vary so much must show: an eighth of a small car's lock
    least_unanswered_rad: float = 0.05
    # times the turning that such commands would make, beyond which they were not obeyed
    largest_unanswered: float = 6.0
    # lags at which commands are this take's and on time: actuators and short clock offsets
    near_s: float = 0.45
    # lags from which commands are as good as another take's: a driver remembers nothing so long
    null_from_s: float = 8.0
    # share of the turning beyond which it is the commands that explain it: clean drives 0.92 and more, wrong ones 0.57
    least_share: float = 0.7
    # share from which all of a take agrees, and its blocks are not judged: a frozen eighth leaves less
    clear_share: float = 0.9
    # share below which the commands are others: wrong ones 0.33 and less at short lags
    foreign_share: float = 0.4
    # by which another lag must explain more, to be the right one
    better_share: float = 0.1
    # share of the squared yaw rate that one constant angle leaves, below which a lag cannot be told
    least_varied: float = 0.1
    # length of the blocks in which commands are judged one by one
    block_s: float = 5.0
    # share of the blocks that must agree, and teach how commands act: a half of a take may be wrong
    trusted_blocks: float = 0.4
    # share of a block's rows that must be known
    filled_block: float = 0.3
    # blocks from which a part that agrees is no chance: a minute
    many_blocks: int = 12
    # fewest blocks that are judged one by one
    min_blocks: int = 6
    # share of a block's squared yaw rate that is left, from which its commands are wrong: clean blocks 0.15 and less
    wrong_block: float = 0.6
    # squared yaw rate of a block by the usual one, below which its own counts as that
    lively_block: float = 0.3
    # share of the wrong blocks' commands that stand at one value, from which they are frozen
    standing_share: float = 0.7
    # share of wrong blocks from which a take cannot be used
    wrong_share: float = 0.12
    # agreement with the opposite sign, from which a sign has changed
    least_opposed: float = 0.6
    # share of the acceleration that wrong throttles explain at most: clean drives 0.3 and more where it varies
    foreign_throttle_share: float = 0.2
    # spread of a throttle by its largest value, from which it must show
    least_throttle_spread: float = 0.15
    # shortest motion by which a throttle is judged: ten of a driver's decisions
    least_judged_s: float = 15.0
    # longest offset that is likelier than any other fault: two clocks that are set by hand
    max_short_offset_s: float = 6.0
    # acceleration by the top speed (1/s) that a varied throttle leaves, from which it is not this car's
    least_varied_pull: float = 0.05
    # acceleration by the top speed (1/s) that no throttle explains, from which it must: at constant throttle 0.08
    least_pull: float = 0.14
    # top wheel speed by the largest reference speed, or its inverse, from which throttles are in another unit
    max_throttle_ratio: float = 4.0
    # share of the rows of clear acceleration in which the wheel may outrun its reference speed
    max_outrun_share: float = 0.4
    # by which a wheel outruns its reference speed: more than slip and the levers of the axles
    outrun: float = 1.25
    # top speed by the largest reference speed that was ever asked for, which a speed control cannot pass
    max_passed: float = 1.15
    # noise of the positions by the wheelbase, from which a car has no heading or speed left (r07: 0.11, also too fast)
    max_place_noise: float = 0.15
    # files beside a take with foreign commands that are tried: those of a day in the lab
    max_neighbours: int = 12
    # largest of these: ten minutes in any text format
    max_neighbour_bytes: int = 1 << 26
    # the largest duty, but for rounding
    max_duty: float = 1.001
    # the least width of a servo's pulse (µs) that is no percentage
    least_pwm: float = 500.0
    # time over which a path shows its direction
    course_s: float = 0.5
    # the models' usual period, over which the speed must be known
    period_s: float = 0.1
    # noise of that speed by the car's usual one, from which poses are mostly noise (r07: 10 cm are 1.2)
    max_speed_noise: float = 0.5
    # turn of the path during which a yaw cannot stand: a full circle
    least_path_turn_rad: float = 6.3
    # turn of the yaw by that of the path, from which the yaw is in degrees: half of what it would be
    degrees_turn: float = 25.0
    # span of a yaw that stands: less than the noise of any tracking over a take
    standing_yaw_rad: float = 0.05


@dataclass(frozen=True)
class ClockJumpLimits:
    """Limits between a clock that jumped within a take and one that did not (`checks/clock_jump`)."""

    # cells between which a take is split
    cell_s: float = 2.0
    # pause of what is known, at which a cell ends: clocks jump there
    gap_s: float = 1.0
    # shortest motion on one side of a jump: five of a driver's decisions
    min_part_s: float = 6.0
    # largest lag that is tried on either side: clocks that are set by hand
    max_lag_s: float = 7.0
    # share of a part's rows whose command must be known at a lag
    least_covered: float = 0.7
    # smallest jump that is told: three steps of the grid (tests/fleet.py: clean drives show at most one)
    least_s: float = 0.12
    # mean square that two lags leave, by that of the best single lag (tests/fleet.py)
    max_left: float = 0.5
    # share of the turning of either part that the commands must explain at its lag
    least_share: float = 0.7
    # difference of the lags right beside the jump, by that of the whole parts: of a clock that drifts it is a half
    least_step: float = 0.75


@dataclass(frozen=True)
class KnownLimits:
    """Limits on gaps, in which neither motion nor commands are known (`checks/known`)."""

    # nominal periods between two poses beyond which the motion there is not known: one lost sample is bridged
    max_gap_periods: float = 2.5
    # commands that are missing for less change no motion that is smoothed over half a second
    short_command_gap_s: float = 0.2
    # time that a servo which is not stated needs to run to any angle: the slowest that are tried first need this
    unknown_servo_s: float = 1.5
    # time constants after which an actuator has forgotten where it stood, but for 5 %
    settled_constants: float = 3.0


@dataclass(frozen=True)
class GeometryLimits:
    """Limits between lengths of a vehicle file that fit the motion and those that do not (tests/fleet.py)."""

    # yaw rate by a large one, from which a row shows a length
    least_turn: float = 0.15
    # lateral acceleration at which tyres hardly slip
    gentle_mps2: float = 0.5
    # largest angle whose tangent says something
    largest_angle_rad: float = 1.2
    # length of the parts that show a length each
    block_s: float = 5.0
    # fewest rows of such a part
    min_rows: int = 20
    # fewest parts
    min_blocks: int = 5
    # share of the wheelbase by which the rear axle may lie elsewhere: tyres slip, and bodies are measured by eye
    rear_share: float = 0.18
    # largest commanded angle from which a wheel shows by the car's turning whether it is driven
    least_drive_angle_rad: float = 0.8
    # residuals by the poses' noise, below which nothing is left to explain
    explained_noise: float = 1.1
    # squared residuals beyond the noise with another driven axle by those with the stated one, below which it is that
    # (tests/fleet.py: 0 to 0.3 where the word is wrong)
    drive_left: float = 0.4
    # nats by which that axle must explain the turning better: a likelihood ratio beyond any doubt
    drive_nats: float = 20.0
    # share of v^2 w that w does not explain, below which a lever and the tyres' slip cannot be told apart
    least_speed_variety: float = 0.1
    # slip of the rear axle by v^2 w (s^2/m) that may then pass for a lever: tyres of 20 m/s^2 per rad
    slip_lever: float = 0.03
    # share of the wheelbase within which two lengths are the same
    same_share: float = 0.1
    # wheelbase by the stated one, or its inverse, that tyres and calibrations make
    wheelbase_factor: float = 1.5
    # standard deviations that a contradiction must pass
    sds: float = 3.0


@dataclass(frozen=True)
class HealthLimits:
    """Limits between a take that is worth fitting and one to drive again."""

    # wheelbases per second of a moving car; not yet justified
    min_moving_speed: float = 0.1
    # shortest motion: twenty stretches of 1.5 s; not yet justified
    min_motion_s: float = 30.0
    # share of the take in which the pose is known, and in which a command is (test_health: a third is too little)
    min_coverage: float = 0.8
    # time without poses and commands from which both were not recorded, and that is no part of the take: a tracking
    # that fails leaves the commands (row 16)
    min_pause_s: float = 5.0
    # steering that shows tyres and inertia (test_health: a straight line does not)
    min_steering_rad: float = 0.1
    # lateral acceleration that shows tyres and inertia (test_health: a straight line does not)
    min_lateral_mps2: float = 0.5
    # spread of speeds by the fastest that tells motor and drag apart (test_health: not in one circle)
    min_speed_spread: float = 0.3
    # braking that shows the brake (test_health: not in one circle)
    min_braking_s: float = 2.0


TABLE, STAMP, MCAP, MESSAGE = TableLimits(), StampLimits(), McapLimits(), MessageLimits()
LOST, STREAM, POSE, MOTION, HEALTH = LostLimits(), StreamLimits(), PoseLimits(), MotionLimits(), HealthLimits()
HEADING = HeadingLimits()
SERVO, AGREEMENT, CLOCK, GEOMETRY = ServoLimits(), AgreementLimits(), ClockLimits(), GeometryLimits()
KNOWN, CLOCK_JUMP = KnownLimits(), ClockJumpLimits()

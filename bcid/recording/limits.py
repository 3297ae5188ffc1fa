"""Limits of checks of poses: what of them is left out, split, warned of or called a no-go.

"Row N" is a row of docs/recordings.md, which says what becomes of a clean drive that is damaged in one way.  Units
are in the fields' names; ratios have none.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class StreamLimits:
    """Limits on the times and numbers of the pose and the command stream."""

    # share of rows without finite numbers (row 12: 10 % are refused)
    max_non_finite_share: float = 0.05
    # share of rows with the stamp of another (test_legitimate)
    max_shared_stamp_share: float = 0.2
    # larger values (m or rad) lie beyond the Earth: another unit; not yet justified
    max_value: float = 1e9
    # s between rows of a measured speed that runs between samples: a vehicle that gains 1 m/s^2 is 0.05 mm off by it
    max_measured_step_s: float = 0.02
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
class InterpolationLimits:
    """Limits between a path that was measured and straight lines that were put between its poses."""

    # steps of the digits by which rounding bends a straight line: a sum of three rows, each half a step off
    rounding_steps: float = 2.0
    # fewest bends beyond rounding of which anything is said
    min_bends: int = 50
    # high quantile of these, a usual bend of measured rows
    usual_quantile: float = 0.9
    # usual bends up to which a row does not bend: noise is as straight in two directions once in half a million rows
    max_straight_share: float = 1e-3
    # what rounding does that a usual bend has to pass, or digits hide what is straight (test_interpolated)
    min_bend_by_rounding: float = 30.0
    # such bends that a step has to pass, or the body is at rest (test_interpolated)
    min_step_by_bend: float = 30.0
    # share of different bends below which they are multiples of a digit (test_interpolated: ticks of an encoder)
    max_coarse_share: float = 0.2
    # low quantile of these, which is about a digit
    digit_quantile: float = 0.01
    # share of straight rows from which a table was filled throughout: between every second one is half of them, and
    # a third where a measured pose falls between two rows
    min_straight_share: float = 0.3
    # share of the corners that come at one rate; others are at what was left out (test_interpolated)
    min_regular_share: float = 0.8
    # straight rows in turn that fill a gap: in noise, never by chance
    min_filled_rows: int = 5
    # share of straight rows in shorter runs, by those that bend, up to which they are chance (test_interpolated: a
    # camera's pixels seen in perspective); such rows of a table that fills single gaps, too, keep their place
    max_single_share: float = 0.01
    # third differences by second ones: 1.83 in white noise, 1.41 where the acceleration is noise
    min_noise_ratio: float = 1.6


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
    # steering command (rad) from which it stands for none: five turns of a wheel, which no controller asks for
    least_placeholder: float = 30.0
    # share of commands that may be placeholders for none: as many as the unit of the others is judged without
    max_placeholder_share: float = 0.05
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
class HealthLimits:
    """Limits between a take that is worth fitting and one to drive again."""

    # wheelbases per second of a moving car; not yet justified
    min_moving_speed: float = 0.1
    # shortest motion: twelve stretches of 1.5 s, the least from which a likelihood knows what chance does
    # (`min_segments` in bcid/likelihood/limits.py)
    min_motion_s: float = 18.0
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


STREAM = StreamLimits()
LOST = LostLimits()
POSE = PoseLimits()
INTERPOLATION = InterpolationLimits()
HEADING = HeadingLimits()
MOTION = MotionLimits()
HEALTH = HealthLimits()

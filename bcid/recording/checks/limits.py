"""Limits of checks of commands: when they are another take's, late, or do not steer the car that is described.

"Row N" is a row of docs/recordings.md, which says what becomes of a clean drive that is damaged in one way.  Units
are in the fields' names; ratios have none.
"""

from dataclasses import dataclass


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
    # factor, or its inverse, of the yaw's turn by that of the path, from which it is another quantity (half, in turns)
    yaw_gain: float = 1.4
    # turn of the path, to and fro, over which both are compared: slip and mounting move the one against the other by
    # some tenths, so that over two full circles the factor is known to a tenth
    least_compared_turn_rad: float = 12.6
    # share of the variance of the yaw's turns that a factor leaves, from which both do not lie on a line: cars steered
    # to 0.5 rad leave 0.0075 at most, cars steered to 2 rad whose factor is misjudged 0.021 and more
    unlike_turns: float = 0.015
    # factor within which a yaw's gain is a known one
    known_yaw_gain: float = 1.2
    # turn of the course within `course_s` that is a car's going back
    turns_round_rad: float = 1.5
    # yaw by which a body is turned from the way that its car goes, so that no command can be judged: an eighth turn
    turned_body_rad: float = 0.785
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
class ClockDriftLimits:
    """Limits of the drift of one clock against the other within a take (`checks/clock_drift`)."""

    # change of the lag over a take that is tried: two laps of a small car look alike from here on
    max_total_s: float = 4.0
    # the same by the take's length: a clock that is 3 % off is another fault
    max_rate: float = 0.03
    # step (rows at 25 Hz) between the changes that are tried: a half of what a map of the commands forgives
    total_step_rows: int = 2


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
class CommandAgeLimits:
    """Limits of the age that commands have when a recorder reads them at its own rate (`checks/command_age`)."""

    # shortest period of reading that is looked at: an age below it hardly moves a car
    least_s: float = 0.03
    # longest: no car is driven by fewer commands
    most_s: float = 0.5
    # fewest changes of the commands that show a period
    least_changes: int = 20
    # steps between changes that are looked at
    most_steps: int = 2000
    # longest period by a short step between changes: rows of a table are a little uneven
    short_step: float = 1.3
    # which of all steps is a short one
    short_quantile: float = 0.05
    # periods that are tried, 0.2 % apart: a step of a second at a tenth of one is then met within a tenth of a period
    periods: int = 1400
    # mean of cos(2 pi step / period): 1 of even steps, 0.9 of those of 0.1 s in rows 0.01 s apart
    least_evenness: float = 0.7
    # width of a peak of that
    same_period: float = 0.25
    # length of the blocks that give a delay each: a driver steers once in a second
    block_s: float = 1.0
    # least information of a block by the usual one, from which it gives a delay
    min_block_share: float = 0.05
    # fewest blocks: a saw has three numbers, an even drift two
    min_blocks: int = 12
    # most blocks: of long takes they are longer
    most_blocks: int = 300
    # fastest beat, in cycles a block: a tooth of a saw of six blocks
    fastest_beat: float = 0.16
    # step between the beats that are tried, in cycles over the take
    beat_step: float = 0.125
    # phases of each that are tried
    phases: int = 24
    # sizes of drifts and jumps that are tried instead
    drifts: int = 41
    # times that delays are found anew, the commands taken from when they were in force, and that the saw is moved
    rounds: int = 2
    # first step of the delay where the saw is moved: a tenth of a servo's lag
    delay_step_s: float = 0.005
    # share of the first steps at which that ends: a tenth of a twenty-fourth of 0.1 s is 0.4 ms
    finest_share: float = 0.1
    # nats by which a saw must explain the delays better than a drift or a jump of one clock
    least_nats: float = 3.0


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


KNOWN = KnownLimits()
AGREEMENT = AgreementLimits()
CLOCK_JUMP = ClockJumpLimits()
CLOCK_DRIFT = ClockDriftLimits()
SERVO = ServoLimits()
CLOCK = ClockLimits()
COMMAND_AGE = CommandAgeLimits()
GEOMETRY = GeometryLimits()

"""Whether the steering commands are those that this car was driven by: how much of its turning they explain, and when.

What explains the turning (`turning_terms`) at the true lag is compared with what explains it at other lags, and block
by block with the map of the blocks that agree.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.recording.checks.agreement import LagScan, scan_lags
from bcid.recording.checks.clock_fault import ClockFault, find_clock_fault
from bcid.recording.checks.commanded_motion import GRID_HZ, CommandedMotion, compare_on_grid
from bcid.recording.checks.limits import AGREEMENT as LIMITS
from bcid.recording.checks.single_track import servo_angles
from bcid.recording.checks.steering_fit import STARTS
from bcid.recording.checks.turning import prepare_turning, split_at_blocks
from bcid.recording.checks.turning_terms import terms_at, turning_terms, turns_leftward
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

MEND_OTHER = "give the commands of this take (--commands FILE, or NAME.commands.csv)"
LAG_STEP = 2  # rows between the lags at which blocks are compared
MEND_DEAD = "log the command that is sent to the servo, and drive again"


class SteeringAgreement(NamedTuple):
    """What the steering commands explain of the turning, and what is wrong with them."""

    share: float = 0.0  # explained at the lag
    lag_s: float = 0.0  # by which the commands act later than stamped, the servo apart
    judged: bool = False  # whether the car turns variedly enough to tell
    agrees: bool = False
    verdict: str | None = None  # a cause and what mends it
    inverted: bool = False  # whether they fit with the other sign
    foreign: bool = False  # whether they fit at no offset, as another take's
    fault: ClockFault | None = None  # by which one clock jumps or drifts within the take
    servo: tuple[float, float] = STARTS[0]  # time constant (s) and rate limit (rad/s) with which they explain it

    @property
    def fits_at_another_time(self) -> bool:
        """Whether the commands fit the whole take, with their sign, at another time than stamped."""
        return self.judged and self.verdict is None and abs(self.lag_s) > LIMITS.near_s

    @property
    def fits_in_part(self) -> bool:
        """Whether the commands fit, with their sign, in a part of the take only, or before and after a clock jumps."""
        return self.judged and self.verdict is not None and not self.inverted and not self.foreign


def judge_steering(motion: CommandedMotion, recording: Recording, vehicle: Vehicle) -> SteeringAgreement:
    """How much of the turning the steering commands explain, with a verdict where they cannot be this car's."""
    v, w, use = motion.speed, motion.turn, motion.use
    left = w[use] - v[use] * float(v[use] @ w[use]) / max(float(v[use] @ v[use]), 1e-12)
    varied = float(left @ left) / max(float(w[use] @ w[use]), 1e-12)
    spread = float(np.std(motion.commands[use & motion.known, 0]))
    steady = spread < LIMITS.least_steering_rad
    turning = float(np.sqrt(np.mean(left**2))) * vehicle.body.wheelbase_m / motion.top_speed
    if steady:
        return SteeringAgreement(verdict=_judge_steady(motion, turning, vehicle))
    if turning < LIMITS.least_turning:
        expected = spread / LIMITS.largest_unanswered
        if turning < expected and spread > LIMITS.least_unanswered_rad:
            return SteeringAgreement(verdict=(
                f"the steering command varies by {spread:.2g} rad, and the car turns as steadily as if by one angle: "
                f"commands of another take, or a steering that was off; {MEND_OTHER}"
            ))  # fmt: skip
        return SteeringAgreement()
    scan, delta, servo = _scan_servos(motion, recording, vehicle)
    leftward = turns_leftward(scan.weights)
    away = np.abs(scan.lags) > LIMITS.near_s * GRID_HZ
    scan = scan._replace(share=np.where(away & ~leftward, 0.0, scan.share))
    near, far = scan.best(-LIMITS.near_s * GRID_HZ, LIMITS.near_s * GRID_HZ), scan.best(-np.inf, np.inf)
    null = scan.null_share(LIMITS.null_from_s * GRID_HZ)
    fault = find_clock_fault(motion, turning_terms(motion, delta)) if varied >= LIMITS.least_varied else None
    if fault is not None:
        return SteeringAgreement(float(scan.share[near]), 0.0, True, False, fault.text, fault=fault)
    blocks = None
    # regular driving comes round again: only a short offset is likelier than a part that agrees as stamped
    soon = abs(scan.lags[far]) < LIMITS.max_short_offset_s * GRID_HZ
    elsewhere = scan.share[far] > LIMITS.clear_share and leftward[far] and soon
    if scan.share[near] < LIMITS.clear_share and varied >= LIMITS.least_varied and not elsewhere:
        blocks = _judge_blocks(motion, delta)
    if blocks is not None:
        return SteeringAgreement(float(scan.share[near]), float(scan.lags[near]) / GRID_HZ, True, False, blocks)
    # commands half a period late look inverted
    rival = scan.share[near] + (LIMITS.better_share if leftward[near] else -LIMITS.better_share)
    # of many long offsets, one fits by chance
    least = LIMITS.least_share if soon else LIMITS.clear_share
    if scan.share[far] > max(least, rival) and leftward[far]:
        lag_s = float(scan.lags[far]) / GRID_HZ
        return SteeringAgreement(float(scan.share[far]), lag_s, True, False, servo=servo)
    share, lag_s = float(scan.share[near]), float(scan.lags[near]) / GRID_HZ
    if share > LIMITS.least_share and not leftward[near] and varied >= LIMITS.least_varied:
        text = "the car turns right where the command says left: the sign is inverted; map it with the other sign"
        return SteeringAgreement(share, lag_s, True, False, text, inverted=True)
    if varied < LIMITS.least_varied:
        return SteeringAgreement(share, lag_s, False, share > LIMITS.least_share, servo=servo)
    if share > LIMITS.least_share:
        return SteeringAgreement(share, lag_s, True, True, servo=servo)
    if share < max(LIMITS.foreign_share, null + LIMITS.better_share):
        text = (
            f"the steering commands explain {share:.0%} of the turning, and no more at any offset: they are another "
            f"take's or another car's; {MEND_OTHER}"
        )
        return SteeringAgreement(share, lag_s, True, False, text, foreign=True)
    return SteeringAgreement(share, lag_s, True, False)


def compare_steering(recording: Recording, vehicle: Vehicle) -> SteeringAgreement:
    """What the steering commands of a recording explain of its turning; nothing is judged where it is too short."""
    data = prepare_turning(recording, vehicle)
    return SteeringAgreement() if data is None else judge_steering(
        compare_on_grid(recording, data, vehicle), recording, vehicle
    )  # fmt: skip


def _judge_steady(motion: CommandedMotion, turning: float, vehicle: Vehicle) -> str | None:
    """The verdict on a steering command that never changes; None where the car turns as steadily as that."""
    v, w, use = motion.speed, motion.turn, motion.use & motion.known
    angle = float(np.median(motion.commands[use, 0]))
    mean = vehicle.body.wheelbase_m * float(v[use] @ w[use]) / max(float(v[use] @ v[use]), 1e-12)
    if turning > LIMITS.least_answered:
        return f"the steering command stays at {angle:.3g} rad while the car turns both ways: it is dead; {MEND_DEAD}"
    if abs(angle) < LIMITS.least_steering_rad and abs(mean) > LIMITS.least_answered:
        return f"the steering command stays at {angle:.3g} rad while the car drives circles: it is dead; {MEND_DEAD}"
    return None


def _scan_servos(
    motion: CommandedMotion, recording: Recording, vehicle: Vehicle
) -> tuple[LagScan, Floats, tuple[float, float]]:
    """What the commands explain at each lag, the servo's angles (N,), T_s (s) and d (rad/s): the stated or the best."""
    given, limit = vehicle.steering, vehicle.steering.max_angle_rad
    servos: tuple[tuple[float, float], ...] = STARTS
    if given.time_constant_s and given.max_rate_radps:
        servos = ((given.time_constant_s, given.max_rate_radps),)
    commands, found = recording.commands, list[tuple[float, LagScan, Floats, tuple[float, float]]]()
    for T_s, d in servos:
        u_s = np.clip(commands.values[:, 0], -limit, limit)
        delta = servo_angles(commands.time_s, u_s, motion.time_s, T_s, d, 0.0)
        scan = scan_lags(motion.turn, motion.use, turning_terms(motion, delta), motion.known)
        found.append((float(scan.share.max()), scan, delta, (T_s, d)))
    return max(found, key=lambda f: f[0])[1:]


def _judge_blocks(motion: CommandedMotion, delta: Floats) -> str | None:
    """The verdict on commands that agree with the turning in a part of the take only; None where all agrees.

    The map from angle to turning, and the lag, are those that explain the best part of the blocks best.
    """
    y, terms, every = motion.turn, turning_terms(motion, delta), np.arange(len(motion.turn))
    reach, best = round(LIMITS.near_s * GRID_HZ), None
    for lag in range(-reach, reach + 1, LAG_STEP):
        X, under = terms_at(terms, motion.known, every, lag)
        few = LIMITS.filled_block * LIMITS.block_s * GRID_HZ
        blocks = split_at_blocks(np.flatnonzero(motion.use & under), motion.time_s, LIMITS.block_s)
        rows = [block for block in blocks if len(block) > few]
        if len(rows) < LIMITS.min_blocks:
            return None
        for begun in _starts(len(rows)):
            weights, good, left = _fit_best_part(X, y, rows, begun)
            if best is None or left < best[0]:
                best = (left, X @ weights, rows, good)
    if best is None:
        return None
    _, predicted, rows, good = best
    size = np.array([np.mean(y[r] ** 2) for r in rows])
    unexplained = np.array([np.mean((y[r] - predicted[r]) ** 2) for r in rows])
    if 1.0 - unexplained[good].sum() / max(size[good].sum(), 1e-12) < LIMITS.clear_share:
        return None
    wrong = np.flatnonzero(unexplained > LIMITS.wrong_block * np.maximum(size, LIMITS.lively_block * size.mean()))
    if len(wrong) < max(2, LIMITS.wrong_share * len(rows)):
        return None
    bad = np.concatenate([rows[i] for i in wrong])
    fault = _name_block_fault(motion, predicted[bad], bad)
    if fault is None and len(rows) < LIMITS.many_blocks:
        # a few blocks agree with any commands
        return None
    fault = fault or "the steering commands explain no turning, and else they do: they are of another time"
    return f"from {motion.time_s[bad[0]]:.0f} to {motion.time_s[bad[-1]]:.0f} s {fault}; cut the take there"


def _starts(count: int) -> list[list[int]]:
    """Groups of `count` blocks from which the search for those that agree begins: all, and each third."""
    third = max(2, count // 3)
    return [list(range(count)), *(list(range(a, min(a + third, count))) for a in range(0, count - 1, third))]


def _fit_best_part(X: Floats, y: Floats, rows: list[Ints], begun: list[int]) -> tuple[Floats, list[int], float]:
    """Least squares of y (N,) on X (N, n) in the blocks that it explains best (least trimmed squares).

    Returns the weights (n,), the blocks, and the mean square that is left there; `begun` are the first blocks' numbers.
    """
    good, weights, left = begun, np.zeros(X.shape[1]), np.zeros(len(rows))
    for _ in range(8):
        kept = np.concatenate([rows[i] for i in good])
        weights, *_ = np.linalg.lstsq(X[kept], y[kept], rcond=None)
        left = np.array([np.mean((y[r] - X[r] @ weights) ** 2) for r in rows])
        chosen = sorted(np.argsort(left)[: max(3, round(LIMITS.trusted_blocks * len(rows)))].tolist())
        if chosen == good:
            break
        good = chosen
    return weights, good, float(left[good].mean())


def _name_block_fault(motion: CommandedMotion, predicted: Floats, rows: Ints) -> str | None:
    """What is wrong with commands in the `rows` in which they disagree with the turning; None where nothing says."""
    y = motion.turn[rows]
    agreement = float(predicted @ y) / max(float(np.linalg.norm(predicted) * np.linalg.norm(y)), 1e-12)
    stands = float(np.median(motion.commands[rows, 0]))
    standing = np.abs(motion.commands[rows, 0] - stands) < LIMITS.least_steering_rad
    # a block at the edge is frozen in part
    if standing.mean() > LIMITS.standing_share:
        return f"the steering command stands at {stands:.3g} rad while the car turns: it is frozen"
    if agreement < -LIMITS.least_opposed:
        opposed = "the car turns right where the command says left, and else as it says"
        return f"{opposed}: the steering's sign changes"
    return None

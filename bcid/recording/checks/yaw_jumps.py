"""Jumps of a yaw: steps in which it changes faster than any car turns, and the stretches between them.

A rigid car's yaw is continuous.  With the yaw rates r on either side of a step of dt seconds, and a yaw acceleration of
at most a, the yaw changes in that step by

    min(r_before, r_after) dt - a dt^2  to  max(r_before, r_after) dt + a dt^2.

A contact changes the rate at once, but not the yaw, and so stays within this.  Two axles that grip with mu in opposite
directions turn a body whose radius of gyration is half its wheelbase L with a = 2 mu g / L.

Between two jumps the yaw is right but for a constant, the level.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.pose_noise import GAUSSIAN_MAD, wrap_angles, written_digits
from bcid.recording.limits import HEADING as LIMITS

SIDE = 3  # steps on either side of a step, whose rates it is compared with
SIDE_S = 0.1  # on either side of jumps, in which samples show what remains of them


class YawJumps(NamedTuple):
    """J jumps of a yaw: the rows of the samples after them, their sizes, and what a car's yaw could differ by (rad)."""

    rows: Ints  # (J,)
    sizes: Floats  # (J,), in (-pi, pi]
    slack: Floats  # (J,)

    def select(self, which: Bools) -> "YawJumps":
        """The jumps that are marked in `which` (J,)."""
        return YawJumps(self.rows[which], self.sizes[which], self.slack[which])


def find_yaw_jumps(time_s: Floats, yaw: Floats, wheelbase_m: float) -> YawJumps:
    """The jumps of a yaw (N,) in rad at times (N,) in s: steps that no car of this wheelbase (m) can make.

    The noise of the steps, judged by how much their rates differ, the digits that the yaw is written in, and
    `HEADING.min_jump_rad` are allowed besides.
    """
    if len(yaw) < 2 * SIDE + 2:
        return YawJumps(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
    usual_s = float(np.median(np.diff(time_s)))
    # two stamps that nearly coincide give no rate
    step_s = np.maximum(np.diff(time_s), 0.5 * usual_s)
    step = wrap_angles(np.diff(yaw))
    rate = step / step_s
    scatter = GAUSSIAN_MAD * usual_s * float(np.median(np.abs(np.diff(rate))))
    digit = float(written_digits(yaw[:, None])[0])
    allowed = LIMITS.min_jump_rad + LIMITS.jump_noise_factor * scatter + LIMITS.jump_digits * digit
    beside_s = np.maximum(*_medians_beside(step_s, 1))
    turned = 0.5 * (step_s + beside_s) * step_s * LIMITS.max_grip_mps2 / wheelbase_m
    beyond = _excess(step, step_s, *_medians_beside(rate, 1)) - turned
    # of several jumps in a row each hides the next one
    beyond = np.maximum(beyond, _excess(step, step_s, *_medians_beside(rate, SIDE)) - SIDE * turned)
    beyond = np.maximum(beyond, np.abs(step) - LIMITS.max_yaw_rate_radps * step_s)
    jumps = beyond > allowed
    size = wrap_angles(step - step_s * steady_rates(rate, jumps))
    half_turn = np.abs(np.abs(size) - math.pi) < LIMITS.flip_tolerance_rad
    # over a gap the car may have turned round
    jumps |= half_turn & (step_s < LIMITS.max_flip_steps * usual_s)
    # the way back may look a little smaller than the way there
    likely = np.flatnonzero(~jumps & (beyond > LIMITS.return_share * allowed))
    jumps[likely] |= _undoes_one_of(size[likely], size[jumps])
    size = wrap_angles(step - step_s * steady_rates(rate, jumps))
    return _measure_jumps(time_s, yaw, YawJumps(np.flatnonzero(jumps) + 1, size[jumps], (turned + allowed)[jumps]))


def _undoes_one_of(sizes: Floats, jumps: Floats) -> Bools:
    """Whether each of `sizes` (M,) (rad) is, but for LIMITS.max_return_misfit of it, the opposite of a jump (K,)."""
    if not len(jumps):
        return np.zeros(len(sizes), dtype=bool)
    known = np.sort(jumps)
    above = np.searchsorted(known, -sizes)
    nearest = (known[np.clip(above + k, 0, len(known) - 1)] for k in (-1, 0))
    undone = [np.abs(sizes + jump) < LIMITS.max_return_misfit * np.abs(jump) for jump in nearest]
    return np.asarray(np.any(undone, axis=0))


def _measure_jumps(time_s: Floats, yaw: Floats, jumps: YawJumps) -> YawJumps:
    """The `jumps` of a yaw (N,) in rad at times (N,) in s, with sizes that agree with the samples around them.

    Jumps within SIDE_S of each other are of sizes whose sum is what remains of them, where straight lines through the
    samples before the first one and after the last one meet.  A single jump of which little remains is none.
    """
    rows, size = jumps.rows, jumps.sizes.copy()
    kept = np.ones(len(rows), dtype=bool)
    count = max(SIDE, round(SIDE_S / float(np.median(np.diff(time_s)))))
    ends = np.flatnonzero(np.diff(rows) > count) + 1
    for group in np.split(np.arange(len(rows)), ends) if len(rows) else []:
        first, last = rows[group[0]], rows[group[-1]]
        middle_s = 0.5 * (time_s[first - 1] + time_s[last])
        sides = (slice(max(0, first - count), first), slice(last, last + count))
        before, after = (_extrapolate(time_s[side] - middle_s, yaw[side]) for side in sides)
        remains = math.remainder(after - before, math.tau)
        alone = len(group) == 1
        if abs(remains) < (LIMITS.return_share if alone else 1.0) * jumps.slack[group].max():
            kept[group] = not alone
            remains = 0.0
        size[group[-1]] += remains - size[group].sum()
    return YawJumps(rows[kept], wrap_angles(size[kept]), jumps.slack[kept])


def _extrapolate(time_s: Floats, yaw: Floats) -> float:
    """The yaw (rad) at time 0 by a straight line through few samples (N,), by medians that single ones do not reach."""
    yaw = np.unwrap(yaw)
    if len(yaw) < 3:
        return float(np.median(yaw))
    i, j = np.triu_indices(len(yaw), 1)
    slope = np.median((yaw[j] - yaw[i]) / (time_s[j] - time_s[i]))
    return float(np.median(yaw - slope * time_s))


def _medians_beside(values: Floats, count: int) -> tuple[Floats, Floats]:
    """Medians (M,) of the `count` values before each of `values` (M,), and of those after it."""
    padded = np.pad(values, count, mode="edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, count), axis=1)
    before, after = medians[: len(values)].copy(), medians[count + 1 :].copy()
    # nothing lies before the first one, nothing after the last one
    before[0], after[-1] = after[0], before[-1]
    return before, after


def _excess(step: Floats, step_s: Floats, before: Floats, after: Floats) -> Floats:
    """Angles (M,) in rad by which steps (M,) lie outside of what the rates (M,) before and after them make of them."""
    low, high = np.minimum(before, after) * step_s, np.maximum(before, after) * step_s
    return np.maximum(step - high, low - step)


def steady_rates(rate: Floats, jumps: Bools) -> Floats:
    """Rates (M,) of change in each of M steps, by those (M,) of the steps around it that are no jumps (M,)."""
    steady = np.flatnonzero(~jumps)
    if not len(steady):
        return np.zeros(len(rate))
    smooth = median_filter(rate[steady], 2 * SIDE + 1, mode="nearest")
    return np.interp(np.arange(len(rate)), steady, smooth)


def label_levels(jumps: YawJumps, time_s: Floats) -> Ints:
    """The level (N,) of each sample at the times (N,) in s, numbered from 0: within one only the car turned the yaw.

    A jump leads to the level of a lasting stretch, where it ends within what the car's own turning makes uncertain, or
    else to a new level.
    """
    edges = np.r_[jumps.rows, len(time_s)]
    # only lasting levels are returned to, and a take has room for few of these
    lasting, numbers, count, height = [0.0], [0], 1, 0.0
    levels = np.zeros(len(time_s), dtype=np.int64)
    for row, end, size, slack in zip(jumps.rows, edges[1:], jumps.sizes, jumps.slack, strict=True):
        height += size
        stays = bool(time_s[end - 1] - time_s[row] > LIMITS.min_mounting_s)
        apart = np.abs(wrap_angles(np.array(lasting) - height))
        nearest = int(np.argmin(apart))
        at, known = numbers[nearest], lasting[nearest]
        if apart[nearest] > min(LIMITS.same_level_slacks * slack, 0.5 * abs(size)):
            at, known, count = count, height, count + 1
            if stays:
                lasting.append(height)
                numbers.append(at)
        # the sum of several jumps close to each other is known better than each of them
        height = known if stays else height
        levels[row:end] = at
    return levels

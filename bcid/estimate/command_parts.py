"""Commands between the rows of a grid: each period cut into the parts in which they are constant.

Loggers and grids have clocks of their own, so that commands change within the grid's periods.  Models in continuous
time are integrated through the parts; models of a fixed period are given the parts' mean, and the steering angle to
which the servo follows all of them.
"""

from collections.abc import Sequence

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.estimate.limits import LIMITS

SAME_TIME_S = 1e-6
"""Difference (s) below which a command's change and a grid row count as simultaneous."""


def cut_into_parts(command_s: Floats, command: Floats, begin_s: Floats, period_s: float) -> Floats:
    """Parts (N, W, 4), [duration (s), u_s, u_m, brake share], of N periods, in each of which commands are constant.

    Commands (M, 2), or (M, 3) with a brake share, hold from their times `command_s` (M,) (s) until the next, the first
    also before its time; periods begin at `begin_s` (N,) (s).  W is the largest number of parts of a period; shorter
    rows end with parts of duration 0.  A period with more changes than `LIMITS.max_command_parts` has as many equal
    parts instead, with the means of the commands in them.
    """
    command = np.pad(command, ((0, 0), (0, 3 - command.shape[1])))
    new = np.r_[True, (np.diff(command, axis=0) != 0.0).any(axis=1)]
    time_s, values = command_s[new], command[new]
    # the first command holds before its time, too, so that it is no change
    first = 1 + np.searchsorted(time_s[1:], begin_s + SAME_TIME_S, side="right")
    stop = 1 + np.searchsorted(time_s[1:], begin_s + period_s - SAME_TIME_S, side="left")
    changes = np.maximum(stop - first, 0)
    busy = changes >= LIMITS.max_command_parts
    width = LIMITS.max_command_parts if busy.any() else 1 + int(changes.max(initial=0))
    column = np.arange(width)
    # the changes within each period, then its end
    at = np.minimum(first[:, None] + column, len(time_s) - 1)
    ends = np.where(column < changes[:, None], time_s[at] - begin_s[:, None], period_s)
    parts = np.empty((len(begin_s), width, 4))
    parts[:, :, 0] = np.diff(ends, axis=1, prepend=0.0)
    held = first[:, None] - 1 + np.minimum(column, changes[:, None])
    parts[:, :, 1:] = values[held]
    for n in np.flatnonzero(busy):
        edges = begin_s[n] + np.linspace(0.0, period_s, width + 1)
        parts[n, :, 0], parts[n, :, 1:] = period_s / width, _mean_commands(time_s, values, edges)
    return parts


def _mean_commands(time_s: Floats, values: Floats, edges: Floats) -> Floats:
    """Time means (n, 3) of commands `values` (M, 3), held from `time_s` (M,), between n + 1 rising `edges` (s)."""
    area = np.vstack([np.zeros(3), np.cumsum(values[:-1] * np.diff(time_s)[:, None], axis=0)])
    row = np.maximum(np.searchsorted(time_s, edges, side="right") - 1, 0)
    whole = area[row] + (edges - time_s[row])[:, None] * values[row]
    means: Floats = np.diff(whole, axis=0) / np.diff(edges)[:, None]
    return means


def hold_for_periods(command: Floats, period_s: float) -> Floats:
    """Parts (..., N, 1, 4), [duration (s), u_s, u_m, brake share], of commands (..., N, 2) that hold for a period."""
    rows = np.ascontiguousarray(command, dtype=np.float64).reshape(-1, 2)
    return _hold(rows, period_s).reshape(*command.shape[:-1], 1, 4)


@njit
def _hold(command: Floats, period_s: float) -> Floats:
    """Parts (n, 4) of commands (n, 2) that hold for a period: compiled, since a short rollout takes little longer."""
    parts = np.empty((len(command), 4))
    for n in range(len(command)):
        parts[n, 0], parts[n, 1], parts[n, 2], parts[n, 3] = period_s, command[n, 0], command[n, 1], 0.0
    return parts


def mean_commands(parts: Floats) -> Floats:
    """Commands [u_s, u_m] (..., N, 2), averaged over the time of each period, of `parts` (..., N, W, 4).

    A command that holds for the whole period is returned to the last digit.
    """
    if parts.shape[-2] == 1:
        return parts[..., 0, 1:3]
    duration, first = parts[..., 0], parts[..., 0, 1:3]
    later = duration[..., None] * (parts[..., 1:3] - first[..., None, :])
    means: Floats = first + later.sum(axis=-2) / duration.sum(axis=-1)[..., None]
    return means


def join_parts(several: Sequence[Floats], axis: int = 0) -> Floats:
    """Arrays of parts (..., N, W, 4) joined along `axis`; where W is smaller, parts of no duration are added."""
    width = max(p.shape[-2] for p in several)
    return np.concatenate([_widen(p, width) for p in several], axis=axis)


def stack_parts(several: Sequence[Floats]) -> Floats:
    """Arrays of parts (N, W, 4) with different W stacked to (B, N, W, 4), filled up by parts of no duration."""
    return join_parts([p[None] for p in several])


def _widen(parts: Floats, width: int) -> Floats:
    """`parts` (..., W, 4) with parts of no duration, and the last command, appended up to `width` a period."""
    missing = width - parts.shape[-2]
    if missing == 0:
        return parts
    more = np.repeat(parts[..., -1:, :], missing, axis=-2)
    more[..., 0] = 0.0
    return np.concatenate([parts, more], axis=-2)


def shift_to_commands(command_s: Floats, command: Floats, period_s: float) -> float:
    """The time (s) in [0, period) at which a grid of `period_s` begins so that commands change least within periods.

    A change by D at the share f of a period adds D^2 f (1 - f) to the variance that averaging over the period loses.
    The shift is 0 unless another one loses less than `LIMITS.shift_gain` of what a grid from 0 would lose.  Commands
    are (M, 2) from their times (M,) on.
    """
    spread = np.var(command, axis=0)
    squares = (np.diff(command, axis=0) ** 2 / np.where(spread > 0.0, spread, 1.0)).sum(axis=1)
    changes = np.flatnonzero(squares)
    changes = changes[:: max(1, len(changes) // LIMITS.shift_changes)]
    if not len(changes):
        return 0.0
    share, weight = np.mod(command_s[changes + 1] / period_s, 1.0), squares[changes]
    candidates = np.unique(np.round(share[:: max(1, len(share) // LIMITS.shift_candidates)], 6)) % 1.0
    f = np.mod(share[None, :] - np.r_[0.0, candidates][:, None], 1.0)
    f[np.minimum(f, 1.0 - f) * period_s < SAME_TIME_S] = 0.0
    losses = (f * (1.0 - f)) @ weight
    best = int(np.argmin(losses))
    return float(np.r_[0.0, candidates][best] * period_s) if losses[best] < LIMITS.shift_gain * losses[0] else 0.0


def braked_share(parts: Floats) -> float:
    """Share of the time in which a brake of its own is on, of `parts` (N, W, 4); learnt models are not told of it."""
    duration = parts[..., 0]
    return float(duration[parts[..., 3] > 0.0].sum() / duration.sum()) if duration.any() else 0.0


def variance_lost(parts: Floats) -> tuple[float, float]:
    """Shares of the variance of steering and throttle commands that lie within periods, of `parts` (N, W, 4).

    It is what a model that is given the mean command of each period does not know.
    """
    duration, values = parts[..., :1], parts[..., 1:3]
    if not duration.any():
        return 0.0, 0.0
    within = (duration * (values - mean_commands(parts)[:, None]) ** 2).sum(axis=(0, 1))
    overall = (duration * (values - (duration * values).sum(axis=(0, 1)) / duration.sum()) ** 2).sum(axis=(0, 1))
    steering, throttle = np.divide(within, overall, out=np.zeros(2), where=overall > 0.0).tolist()
    return steering, throttle

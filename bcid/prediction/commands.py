"""Commands of a prediction, in the parts of each period: from a file, from an array, or as a recording has them."""

import math
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused, UsageError
from bcid.estimate.command_parts import cut_into_parts, hold_for_periods
from bcid.estimate.types import Estimate
from bcid.prediction.limits import LIMITS
from bcid.recording.formats.commands_file import read_commands_file

NEXT_ROW = "write a time and two numbers in every row"


def read_command_parts(path: Path, period_s: float, duration_s: float | None) -> Floats:
    """Parts (N, W, 4) of the periods of a commands file, whose second zero is the start of the prediction.

    Each command holds until the next one, the last as long as most others, or until `duration_s` (s) are over.

    Raises:
        InputRefused: the file is missing or damaged, its times do not increase, it says nothing of the start, or it
            lasts no time or too long.
    """
    take = read_commands_file(path)
    time_s, command = take.command_time_s, take.command
    if not (np.isfinite(time_s).all() and np.isfinite(command).all()) or np.any(np.diff(time_s) <= 0.0):
        cause = "holds blank cells, or times that do not increase"
        raise InputRefused(path, "commands file", cause, NEXT_ROW)
    if time_s[0] > 0.0:
        cause = f"begins at {time_s[0]:g} s, and says nothing of the start of the prediction"
        raise InputRefused(path, "time_s", cause, "give the command that holds at time 0")
    usual = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    lasting = float(time_s[-1]) + usual if duration_s is None else duration_s
    if not 0.0 < lasting <= LIMITS.max_predicted_s:
        cause = f"lasts {lasting:g} s"
        raise InputRefused(path, "time_s", cause, f"predict up to {LIMITS.max_predicted_s:g} s, or give a duration")
    begin = period_s * np.arange(count_periods(lasting, period_s), dtype=np.float64)
    return cut_into_parts(time_s, command, begin, period_s)


def command_array_parts(commands: Floats, period_s: float, duration_s: float | None) -> Floats:
    """Parts (N, W, 4) of an array of commands: [u_s (rad), u_m] (N, 2), one a period, or parts themselves.

    Raises:
        UsageError: it has another shape, a number that is not finite, or less than `duration_s` (s).
    """
    if not (commands.ndim == 2 and commands.shape[1] == 2) and not (commands.ndim == 3 and commands.shape[2] == 4):
        raise UsageError(f"commands are of the shape {commands.shape}\n  next: give (N, 2), [u_s, u_m] of each period")
    if not len(commands) or not np.isfinite(commands).all():
        raise UsageError("commands hold none, or a number that is not finite\n  next: give two numbers for each period")
    wanted = len(commands) if duration_s is None else count_periods(duration_s, period_s)
    if wanted > len(commands):
        asked, known = wanted * period_s, len(commands) * period_s
        raise UsageError(f"commands last {known:g} s, not {asked:g} s\n  next: give more, or a shorter duration")
    commands = commands[:wanted]
    return hold_for_periods(commands, period_s) if commands.ndim == 2 else commands


def recorded_command_parts(estimate: Estimate, row: int, duration_s: float | None) -> Floats:
    """Parts (N, W, 4) of the commands of a recording from a row of its estimate on, to the end of the row's segment.

    Raises:
        InputRefused: the recording goes on for less than `duration_s` (s).
    """
    (stop,) = (s.stop for s in estimate.segments() if s.start <= row < s.stop)
    known = stop - 1 - row
    wanted = known if duration_s is None else count_periods(duration_s, estimate.period_s)
    if not 0 < wanted <= known:
        cause = f"the motion goes on for {known * estimate.period_s:g} s without a gap"
        step = "predict less, from an earlier moment, or give commands of your own"
        raise InputRefused(estimate.name, f"{estimate.time_s[row]:g} s", cause, step)
    return estimate.parts[row : row + wanted]


def count_periods(duration_s: float, period_s: float) -> int:
    """How many periods of `period_s` cover a time `duration_s` (both s).

    Raises:
        UsageError: the time is not positive, or longer than predictions are.

    >>> count_periods(0.3, 0.1), count_periods(0.31, 0.1)
    (3, 4)
    """
    if not 0.0 < duration_s <= LIMITS.max_predicted_s:
        raise UsageError(f"a prediction of {duration_s:g} s\n  next: ask for up to {LIMITS.max_predicted_s:g} s")
    return math.ceil(duration_s / period_s - 1e-6)

"""The samples of the pose and command streams: put in order of time, their times checked, and their gaps found."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused
from bcid.recording.limits import POSE, STREAM
from bcid.recording.types import Action, Irregularity

OVERLAP_STEPS = {
    "mcap": '; or name the time base: topics.time = "log"',
    "motive": "; or say what the commands' stamps read at frame 0: [commands] time_zero",
    "table": "; or, of a commands file, say what its stamps read at the first pose: [commands] time_zero",
}
"""Further advice, by the kind of a take's format, where its poses and commands do not overlap in time."""


class Samples(NamedTuple):
    """Samples of a stream: times (N,) in s, values (N, n), and the irregularities found so far."""

    time_s: Floats
    values: Floats
    irregularities: list[Irregularity]

    def without(self, rows: Bools, kind: str, action: Action, detail: str) -> Samples:
        """The samples outside the marked `rows` (N,), which are noted as one irregularity of this kind."""
        noted = [*self.irregularities, *note_rows(self.time_s, rows, kind, action, detail)]
        return Samples(self.time_s[~rows], self.values[~rows], noted)


def note_rows(time_s: Floats, rows: Bools, kind: str, action: Action, detail: str) -> list[Irregularity]:
    """One irregularity that counts the rows marked in `rows` (N,) and gives their time span; [] where none is marked.

    `kind`, `action` and `detail` are that irregularity's own fields.
    """
    if not rows.any():
        return []
    hit = time_s[rows & np.isfinite(time_s)]
    where = f"{hit[0]:.3f} s" if len(hit) == 1 else f"row {int(np.argmax(rows)) + 1}"
    if len(hit) > 1:
        where = f"{hit.min():.3f} to {hit.max():.3f} s"
    return [Irregularity(kind, action, int(rows.sum()), where, detail)]


def throttle_at(time_s: Floats, commands: Samples) -> Floats:
    """Throttle u_m (N,) (m/s, a brake share below 0) of the latest command at each time (N,); 0 before the first."""
    row = np.searchsorted(commands.time_s, time_s, side="right") - 1
    return np.where(row >= 0, commands.values[np.maximum(row, 0), 1], 0.0)


def clean_samples(time_s: Floats, values: Floats, stream_name: str, source: str) -> Samples:
    """The samples with finite times (N,) in s and values (N, n), each once, in strictly increasing order of time.

    Raises:
        InputRefused: there are no samples, many are no finite numbers, or the clock steps back.
    """
    if len(time_s) == 0:
        raise InputRefused(source, stream_name, "holds no samples", "record the take again")
    largest = float(np.abs(time_s[np.isfinite(time_s)]).max(initial=0.0))
    if largest > STREAM.max_time_s:
        cause = f"times reach {largest:.3g}: are they in seconds?"
        raise InputRefused(source, f"{stream_name} times", cause, "write or map them in seconds")
    infinite = (np.abs(values) > STREAM.max_value).any(axis=1) | ~np.isfinite(time_s)
    if infinite.mean() > STREAM.max_non_finite_share:
        cause = f"{infinite.mean():.0%} of the rows are not finite numbers"
        raise InputRefused(source, stream_name, cause, "export the take again")
    blank = ~np.isfinite(values).all(axis=1) & ~infinite
    if (blank | infinite).all():
        raise InputRefused(source, stream_name, "holds no finite sample", "export the take again")
    text = "not finite numbers (nan, inf, or too large)"
    samples = Samples(time_s, values, []).without(infinite, f"{stream_name} numbers", "excluded", text)
    text = f"blank samples in {int(np.sum(np.diff(np.r_[0, blank]) == 1))} runs: gaps"
    samples = samples.without(blank[~infinite], f"{stream_name} dropout", "excluded", text)
    _, first = np.unique(np.column_stack([samples.time_s, samples.values]), axis=0, return_index=True)
    again = ~np.isin(np.arange(len(samples.time_s)), first)
    samples = samples.without(again, f"{stream_name} duplicate", "fixed", "same stamp, same value: once")
    return _drop_contradictions(_sort_by_time(samples, stream_name, source), stream_name, source)


def _sort_by_time(samples: Samples, stream_name: str, source: str) -> Samples:
    """The samples sorted by time, if some came late, without those whose times come twice by a clock that was set back.

    Raises:
        InputRefused: the clock was set back so far that many samples have times twice.
    """
    time_s = samples.time_s
    back = np.r_[0.0, -np.diff(time_s)]
    if not (back > 0.0).any():
        return samples
    far = back > 0.5 * STREAM.max_late_samples * float(np.median(np.abs(np.diff(time_s))))
    for row in np.flatnonzero((back > 0.0) & far):
        again = int((time_s[:row] > time_s[row]).sum())
        ahead = int((time_s[row:] < time_s[row - 1]).sum())
        if min(again, ahead) > STREAM.max_late_samples:
            where = f"by {back[row]:.3f} s at {time_s[row - 1]:.3f} s"
            cause = f"the clock steps back {where}: {again} samples have times twice"
            step = "cut the recording there, or use the other time base"
            raise InputRefused(source, f"{stream_name} times", cause, step)
    set_back = find_set_backs(time_s)
    if set_back:
        twice, furthest = np.zeros(len(time_s), dtype=bool), max(set_back, key=lambda span: span[1] - span[0])
        for start, stop in set_back:
            twice |= (time_s >= start) & (time_s <= stop)
        by_s = furthest[1] - furthest[0] + float(np.median(np.abs(np.diff(time_s))))
        by = f"set back by {by_s:.3f} s at {furthest[1]:.3f} s"
        often = "" if len(set_back) == 1 else f" and {len(set_back) - 1} times more"
        text = f"the clock was {by}{often}: samples whose times come twice are left out: split there"
        samples = samples.without(twice, f"{stream_name} clock", "excluded", text)
        time_s = samples.time_s
        back = np.r_[0.0, -np.diff(time_s)]
    noted = note_rows(time_s, back > 0.0, f"{stream_name} order", "fixed", "samples put in the order of time")
    order = np.argsort(time_s, kind="stable")
    return Samples(time_s[order], samples.values[order], [*samples.irregularities, *noted])


def find_set_backs(time_s: Floats) -> list[tuple[float, float]]:
    """Spans (s) of times that come twice, since the clock of samples at times (N,) in s was set back to their start.

    A sample that only came late has its own time: sorted, such samples are as dense as all others.
    """
    ordered = np.sort(time_s[np.isfinite(time_s)])
    usual_s = float(np.median(np.diff(ordered))) if len(ordered) > 1 else 0.0
    if usual_s <= 0.0:
        return []
    rows = np.flatnonzero(np.diff(time_s) < -usual_s)
    start, stop = time_s[rows + 1], time_s[rows]
    count = np.searchsorted(ordered, stop, side="right") - np.searchsorted(ordered, start, side="left")
    twice = count > STREAM.min_doubled * ((stop - start) / usual_s + 1.0)
    return list(zip(start[twice].tolist(), stop[twice].tolist(), strict=True))


def _drop_contradictions(samples: Samples, stream_name: str, source: str) -> Samples:
    """The samples without those that share a time but differ in values; `InputRefused` where very many do."""
    _, inverse, counts = np.unique(samples.time_s, return_inverse=True, return_counts=True)
    shared = counts[inverse] > 1
    if shared.mean() > STREAM.max_shared_stamp_share:
        cause = f"{shared.mean():.0%} of the samples share a stamp with another: are the stamps rounded?"
        step = "log them with more digits, or use the other time base"
        raise InputRefused(source, f"{stream_name} times", cause, step)
    return samples.without(shared, f"{stream_name} duplicate", "excluded", "same stamp, other value: all dropped")


def check_pose_times(pose_s: Floats, source: str) -> None:
    """Raise `InputRefused` where pose times (N,) cannot be seconds of one take: too few, of odd rate, or too long."""
    if len(pose_s) < STREAM.min_poses:
        raise InputRefused(source, "pose", f"only {len(pose_s)} poses remain", "record a longer take")
    step = float(np.median(np.diff(pose_s)))
    if not STREAM.min_rate_hz < 1.0 / step < STREAM.max_rate_hz:
        cause = f"poses come every {step:.3g} s: are the times in seconds?"
        raise InputRefused(source, "time", cause, "map the time column in seconds")
    span = float(pose_s[-1] - pose_s[0])
    if span > STREAM.max_span_excess_s + STREAM.max_span_factor * step * len(pose_s):
        near = f"near {pose_s[int(np.argmax(np.diff(pose_s)))]:.3f} s"
        cause = f"{len(pose_s)} poses spread over {span:.3g} s: a clock jump or a zero stamp {near}"
        raise InputRefused(source, "time", cause, "cut the take there, or correct its stamps")


def check_command_times(commands: Samples, hold_s: float, source: str, several_publishers: bool = False) -> None:
    """Raise `InputRefused` where commands come less often than every `hold_s` seconds, or two sources send by turns.

    A controller that chatters alternates, too: there are two sources only where the file shows `several_publishers`,
    or where the times are those of two clocks.
    """
    step = float(np.median(np.diff(commands.time_s))) if len(commands.time_s) > 1 else 0.0
    if step > hold_s:
        cause = f"commands come every {step:.3g} s, but hold for {hold_s:g} s only"
        mapped = 'map their unit (ms: time_s = { from = "…", gain = 0.001 })'
        raise InputRefused(
            source, "command times", cause, f"log them in seconds, or {mapped}, or set command.max_hold_s"
        )
    if sources_alternate(commands.values) and (several_publishers or clocks_alternate(commands.time_s)):
        cause = "two sources of commands alternate: several publishers on the topic, or two stretches mixed"
        raise InputRefused(source, "command", cause, "record the one that the car obeys")


def clocks_alternate(time_s: Floats) -> bool:
    """Whether times (N,) in s are those of two regular clocks by turns: every second step is alike, neighbours are not.

    Steps of one clock with jitter are not correlated with the second next ones.
    """
    step = np.diff(time_s)
    if len(step) < STREAM.min_poses or step.std() < POSE.min_turn_spread * step.mean():
        return False
    # pauses would outweigh all other steps
    around = np.minimum(step, STREAM.gap_steps * float(np.median(step))) - float(np.median(step))
    around -= around.mean()
    power = float(around[:-2] @ around[:-2]) * float(around[2:] @ around[2:])
    return power > 0.0 and float(around[:-2] @ around[2:]) > POSE.min_turn_correlation * power**0.5


def check_streams_overlap(pose_s: Floats, command_s: Floats, source: str, format_name: str) -> None:
    """Raise `InputRefused` where the time spans of poses (N,) and of commands (M,), in s, do not overlap.

    `format_name` is that of the poses' file, by which the next step is chosen.
    """
    (first, last), (begin, end) = ((t[0], t[-1]) for t in (pose_s, command_s))
    if min(last, end) <= max(first, begin):
        spans = f"poses ({first:.3f} to {last:.3f} s) and commands ({begin:.3f} to {end:.3f} s)"
        cause = f"{spans} do not overlap in time: two takes, or simulated time and a wall clock"
        step = f"check that both belong to one take{OVERLAP_STEPS.get(format_name.partition('-')[0], '')}"
        raise InputRefused(source, "time", cause, step)


def is_regular(time_s: Floats) -> bool:
    """Whether most samples at times (M,) in s, of two at least, come within a usual step of the one before."""
    steps = np.diff(time_s)
    return bool((steps <= STREAM.gap_steps * float(np.median(steps))).mean() > STREAM.min_regular_share)


def longest_command_step(command_s: Floats, hold_s: float) -> float:
    """Longest time (s) between two commands (M,) at which no command in between is taken as lost.

    It is `STREAM.gap_steps` times the median step, but at most `hold_s`, the longest time for which a command holds;
    and `hold_s` where commands are not sent at a regular rate.
    """
    if len(command_s) < 2:
        return hold_s
    limit = STREAM.gap_steps * float(np.median(np.diff(command_s)))
    return min(limit, hold_s) if is_regular(command_s) else hold_s


def find_gaps(time_s: Floats, longest_s: float, stream_name: str) -> list[Irregularity]:
    """A warning of a stream's gaps: steps between its sample times (N,) longer than `longest_s` (s); [] without any."""
    steps = np.diff(time_s)
    wide = steps > longest_s
    text = f"{steps[wide].sum():.2f} s in all, the longest {steps.max(initial=0.0):.3f} s"
    return note_rows(time_s, np.r_[False, wide], f"{stream_name} gap", "warning", text)


def find_uncovered_ends(pose_s: Floats, command_s: Floats, hold_s: float, step_s: float) -> list[Irregularity]:
    """Warnings where a take begins or ends with only poses (N,) or only commands (M,): one of their logs may be cut.

    Poses may start later or stop earlier than commands by `hold_s`, and commands than poses by `step_s` (s).
    """
    spans = {"command": (command_s[0], command_s[-1], step_s), "pose": (pose_s[0], pose_s[-1], hold_s)}
    warnings = []
    for name, partner in (("command", "pose"), ("pose", "command")):
        (first, last, slack_s), (begin, end, _) = spans[name], spans[partner]
        for edge, at, apart in (("begin", first, first - begin), ("end", last, end - last)):
            if apart > slack_s:
                where = f"after the first {partner}" if edge == "begin" else f"before the last {partner}"
                text = f"the {name}s {edge} {apart:.2f} s {where}"
                warnings.append(Irregularity(f"{name} {edge}", "warning", 1, f"{at:.3f} s", text))
    return warnings


def sources_alternate(values: Floats) -> bool:
    """Whether two sources write a stream (N, n) by turns: samples lie nearer to the next but one than to the next."""
    if len(values) < 3:
        return False
    to_next, to_second = (np.linalg.norm(values[k:] - values[:-k], axis=1) for k in (1, 2))
    to_next = to_next[:-1]
    moved = (to_next > 0.0) & (to_next >= np.median(to_next))
    nearer = to_second[moved] < POSE.alternating_distance * to_next[moved]
    return bool(moved.mean() > POSE.min_moving_share and nearer.mean() > POSE.min_alternating_share)

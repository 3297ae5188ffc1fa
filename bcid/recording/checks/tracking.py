"""Failures of the tracking in a pose stream: held and turned poses, other bodies, jumps."""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.checks.samples import Samples, where
from bcid.recording.types import Irregularity
from bcid.vehicle import Vehicle

FROZEN_S = 0.25  # that a pose may stand to the last digit while the throttle is on
RESUMES = 2.0  # usual steps, by which a pose that was held goes on
FLIP = 0.2  # rad about half a turn between two samples
MAX_SPEED_MPS = 100.0
MAX_JUMPS = 0.05  # share of the pose steps; more is no tracking failure but a wrong unit
AROUND = 11  # steps that a step is compared with
JUMP_FACTOR, JUMP_SPEED_MPS = 3.0, 2.0  # faster than the steps around it, and at least by this
NOISE_FACTOR = 10.0
SPIKE_S = 0.1  # the longest stretch between two jumps that is nothing but outliers
GHOST_SIZE = 0.1  # wheelbases within which a static ghost stays
STANDS_S = 0.5  # beside a jump, that nothing moves
DRIVEN_SHARE = 0.8  # of a stretch with the throttle on
MIXED, MIXED_SHARE = 0.5, 0.7  # nearer by this factor, in this share of the steps that are large
MOVED = 0.3  # share of the steps that are large, at least
HUMAN_S, FEW_LEVELS = 0.08, 8  # no driver goes to and fro more often, between more levels
HARD_MPS2 = 60.0  # a change of speed that neither tyres nor a contact make


def unheld(poses: Samples) -> Samples:
    """The poses each once, where a table or a topic holds the last one until the next comes."""
    new = np.r_[True, (np.diff(poses.values, axis=0) != 0.0).any(axis=1)]
    changes = np.flatnonzero(new)
    if len(changes) < 3 or np.median(np.diff(changes)) < 2.0:
        return poses
    text = f"each pose is held for {np.median(np.diff(changes)):.0f} samples: the first of them counts"
    odd = Irregularity("pose held", "fixed", int((~new).sum()), where(poses.time_s, ~new), text)
    return Samples(poses.time_s[new], poses.values[new], [*poses.odd, odd])


def unfrozen(poses: Samples, commands: Samples) -> Samples:
    """The poses without those that only repeat the last one while the throttle is on: the tracking held it."""
    time_s, values = poses.time_s, poses.values
    same = np.r_[False, (np.diff(values, axis=0) == 0.0).all(axis=1)]
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(int)))
    frozen, stands = np.zeros(len(time_s), dtype=bool), np.zeros(len(time_s), dtype=bool)
    throttle = _throttle(time_s, commands)
    usual = float(np.quantile(np.hypot(*np.diff(values[:, :2], axis=0).T), 0.9))
    for a, b in edges.reshape(-1, 2):
        # a car that pushes against a wall goes on from where it stood, one that was hidden has moved meanwhile
        moved = b == len(values) or math.dist(values[b, :2], values[b - 1, :2]) > RESUMES * usual
        if time_s[b - 1] - time_s[a - 1] > FROZEN_S and throttle[a:b].min() > 0.0:
            (frozen if moved else stands)[a:b] = True
    odd, text = [], "the same pose again and again while the throttle is on: "
    if frozen.any():
        held = text + "held by the tracking"
        odd.append(Irregularity("frozen pose", "excluded", int(frozen.sum()), where(time_s, frozen), held))
    if stands.any():
        still = text + "it goes on from there, as from a wall"
        odd.append(Irregularity("pose stands", "warning", int(stands.sum()), where(time_s, stands), still))
    return Samples(time_s[~frozen], values[~frozen], [*poses.odd, *odd])


def without_flips(poses: Samples, commands: Samples) -> Samples:
    """The poses without stretches whose yaw is turned by 180 degrees: markers that look the same both ways."""
    yaw = poses.values[:, 2]
    step = np.diff(poses.time_s)
    half = np.abs(np.abs(np.angle(np.exp(1j * np.diff(yaw)))) - math.pi) < FLIP
    half &= step < 3.0 * float(np.median(step))  # over a gap the car may have turned round
    if not half.any():
        return poses
    turned = np.r_[0, np.cumsum(half)] % 2 == 1
    if _goes_forward(poses, commands, turned) > _goes_forward(poses, commands, ~turned):
        turned = ~turned
    text = "the yaw jumps by 180 degrees: symmetric markers; what would drive backwards is left out"
    odd = Irregularity("yaw flip", "excluded", int(turned.sum()), where(poses.time_s, turned), text)
    return Samples(poses.time_s[~turned], poses.values[~turned], [*poses.odd, odd])


def _goes_forward(poses: Samples, commands: Samples, rows: npt.NDArray[np.bool_]) -> float:
    """How far the car goes where its yaw points while the throttle is on: 1 forward, -1 backward, 0 unknown."""
    step = np.diff(poses.values[:, :2], axis=0)
    far = np.hypot(*step.T)
    use = rows[1:] & rows[:-1] & (far > 0.2 * np.quantile(far, 0.95)) & (_throttle(poses.time_s[1:], commands) > 0.0)
    if not use.any():
        return 0.0
    return float(np.cos(np.arctan2(step[use, 1], step[use, 0]) - poses.values[1:][use, 2]).mean())


def _throttle(time_s: Floats, commands: Samples) -> Floats:
    """The throttle that holds at these times; 0 before the first command."""
    row = np.searchsorted(commands.time_s, time_s, side="right") - 1
    return np.where(row >= 0, commands.values[np.maximum(row, 0), 1], 0.0)


def in_turn(values: Floats) -> bool:
    """Whether two sources write to one stream: in most steps the sample after the next is nearer than the next one."""
    if len(values) < 3:
        return False
    next_one, second = (np.linalg.norm(values[k:] - values[:-k], axis=1) for k in (1, 2))
    next_one = next_one[:-1]
    moved = (next_one > 0.0) & (next_one >= np.median(next_one))
    return bool(moved.mean() > MOVED and (second[moved] < MIXED * next_one[moved]).mean() > MIXED_SHARE)


def commands_in_turn(commands: Samples) -> bool:
    """Whether two publishers send commands in turn: quickly, and not between a few levels as a driver may."""
    levels = len(np.unique(np.round(commands.values, 6), axis=0))
    quick = len(commands.time_s) > 1 and float(np.median(np.diff(commands.time_s))) < HUMAN_S
    return bool(quick and levels > FEW_LEVELS and in_turn(commands.values))


def _jumps(poses: Samples, vehicle: Vehicle) -> npt.NDArray[np.int64]:
    """Rows before which the pose jumps faster than any car moves, or far faster than it did just before and after."""
    step_s = np.diff(poses.time_s)
    step_s = np.maximum(step_s, 0.5 * float(np.median(step_s)))  # two stamps that nearly meet are no speed
    limit = vehicle.mocap.max_speed_mps or MAX_SPEED_MPS
    speed = np.hypot(*np.diff(poses.values[:, :2], axis=0).T) / step_s
    around = median_filter(speed, AROUND, mode="nearest")
    noise = 1.4826 * float(np.median(np.abs(speed - around)))
    sudden = speed > np.maximum(JUMP_FACTOR * around, JUMP_SPEED_MPS) + NOISE_FACTOR * noise
    sudden &= speed - around > HARD_MPS2 * step_s
    if np.quantile(around, 0.95) > limit:
        sudden |= speed > limit  # all of it, not some samples
    return np.flatnonzero(sudden | (speed > limit + NOISE_FACTOR * noise)) + 1


def split_at_jumps(poses: Samples, commands: Samples, vehicle: Vehicle, source: str) -> tuple[Samples, list[float]]:
    """The poses of the car, without outliers and static ghosts between two jumps; and where stretches begin.

    Raises:
        InputRefused: two bodies in turn, or jumps everywhere.
    """
    if in_turn(poses.values[:, :2]):
        cause = "two bodies come in turn: several publishers on the topic, a label that swaps, or two stretches mixed"
        raise InputRefused(source, "pose", cause, "record one body a topic, or name it in the vehicle file")
    time_s, values = poses.time_s, poses.values
    jumps = _jumps(poses, vehicle)
    if len(jumps) > MAX_JUMPS * len(values):
        raise InputRefused(
            source, "pose", f"{len(jumps)} of {len(values)} pose steps are faster than the car: "
            "lengths in mm or cm, a body that swaps, or two stretches of time mixed?",
            "set the unit (mocap.length_unit, or a gain in [columns]), or mocap.max_speed_mps; check the body",
        )  # fmt: skip
    ghost, odd = _not_the_car(poses, commands, jumps, vehicle)
    if len(jumps):
        at = np.zeros(len(time_s), dtype=bool)
        at[jumps] = True
        far = max(math.dist(values[j, :2], values[j - 1, :2]) for j in jumps)
        text = f"by up to {far:.3f} m from one sample to the next: split there"
        odd.append(Irregularity("pose jump", "excluded", len(jumps), where(time_s, at), text))
    kept = time_s[~ghost]
    breaks = sorted({float(kept[k]) for k in np.searchsorted(kept, time_s[jumps]) if 0 < k < len(kept)})
    return Samples(kept, values[~ghost], [*poses.odd, *odd]), breaks


def _not_the_car(
    poses: Samples, commands: Samples, jumps: npt.NDArray[np.int64], vehicle: Vehicle
) -> tuple[npt.NDArray[np.bool_], list[Irregularity]]:
    """Outliers between two jumps, and what stands still beside a jump while the throttle is on."""
    time_s, xy = poses.time_s, poses.values[:, :2]
    size = GHOST_SIZE * (vehicle.body.cog_to_front_m + vehicle.body.cog_to_rear_m)
    driven = _throttle(time_s, commands) > 0.0
    found = np.zeros(len(time_s), dtype=bool)
    kinds: dict[str, npt.NDArray[np.bool_]] = {}

    def leave_out(i: int, j: int, text: str) -> None:
        kinds.setdefault(text, np.zeros(len(time_s), dtype=bool))[i:j] = True
        found[i:j] = True

    for a, b in itertools.pairwise([0, *jumps, len(time_s)]):
        begins, ends = a > 0, b < len(time_s)
        if begins and ends and time_s[b - 1] - time_s[a] < SPIKE_S:
            leave_out(a, b, "an outlier between two jumps")
            continue
        for i, j in _standing(xy, a, b, begins, ends, size):
            least = SPIKE_S if (i, j) == (a, b) else STANDS_S
            held = bool((xy[i:j] == xy[i]).all())  # to the last digit: by the tracking, whatever the throttle does
            if time_s[j - 1] - time_s[i] >= least and (held or driven[i:j].mean() > DRIVEN_SHARE):
                leave_out(i, j, "held by the tracking" if held else "stands still while the throttle is on: a ghost")
    return found, [
        Irregularity("tracking", "excluded", int(rows.sum()), where(time_s, rows), text) for text, rows in kinds.items()
    ]


def _standing(xy: Floats, a: int, b: int, begins: bool, ends: bool, size: float) -> list[tuple[int, int]]:
    """The parts of the rows a to b in which nothing moves, from the jump that begins or to the one that ends them."""
    parts = []
    for within in (size, 0.0):
        first, last = _still(xy[a:b], within), _still(xy[a:b][::-1], within)
        if first == b - a:
            return [(a, b)] if begins or ends else []
        parts += ([(a, a + first)] if begins else []) + ([(b - last, b)] if ends else [])
    return list(dict.fromkeys(parts))


def _still(xy: Floats, size: float) -> int:
    """How many of the first samples lie within `size` of the first one."""
    far = np.hypot(*(xy - xy[0]).T) > size
    return int(np.argmax(far)) if far.any() else len(xy)

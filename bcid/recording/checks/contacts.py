"""Bumper contacts and crashes: accelerations that no tyre and no motor can give.

A contact changes the velocity, and for longer than tyres would need to change it back; the path goes on from where it
was.  Where the path steps aside but its velocity stays, the body was knocked on the car, or redefined.  Where neither
lasts, it was noise.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.pose_noise import white_noise
from bcid.recording.limits import MOTION as LIMITS
from bcid.recording.types import Irregularity, Recording

HALF_WINDOW_S = 0.05  # over which velocity is taken, before an instant and after it
BETWEEN = 9  # instants at which the lines before and after a contact are compared


class Contact(NamedTuple):
    """One contact: when (s from the first pose), where, of which kind, and how strong."""

    begin_s: float
    end_s: float
    x_m: float
    y_m: float
    kind: str  # contact, crash where the car stands afterwards, or mounting where the path steps aside
    acceleration: float  # m/s², the largest
    aside_m: float  # by which the path steps aside


def split_at_contacts(recording: Recording) -> Recording:
    """The recording with a break before and after each contact (bump or crash), so that no segment goes across it."""
    first, odd, breaks = recording.poses.time_s[0], list[Irregularity](), set(recording.breaks_s)
    for c in _find_sudden_changes(recording):
        begin_s, end_s = float(first + c.begin_s), float(first + c.end_s)
        # where the track jumps, the acceleration is not the car's
        if any(begin_s <= at <= end_s for at in recording.breaks_s):
            continue
        text = f"at ({c.x_m:.2f}, {c.y_m:.2f}) m, {c.acceleration:.0f} m/s² that no tyre gives: a separate segment"
        if c.kind == "mounting":
            text = f"the position steps by {c.aside_m:.3f} m at once and the car goes on as before: a marker was " \
                "knocked, or the body defined anew: split there; record both sides as takes of their own"  # fmt: skip
        odd.append(Irregularity(c.kind, "excluded", 1, f"{begin_s:.3f} to {end_s:.3f} s", text))
        breaks |= {begin_s, end_s}
    return replace(recording, breaks_s=tuple(sorted(breaks)), irregularities=(*recording.irregularities, *odd))


def find_contacts(recording: Recording) -> list[Contact]:
    """The contacts (bumps and crashes) of a recording, in order of time: changes of velocity that no tyre can make."""
    return [c for c in _find_sudden_changes(recording) if c.kind != "mounting"]


def _find_sudden_changes(recording: Recording) -> list[Contact]:
    """The contacts of a recording, and steps of its path, in order of time: where positions accelerate too much.

    The acceleration at an instant is a finite difference of two velocities, the slopes of lines through the poses
    within HALF_WINDOW_S (at least three poses) before and after it.  A contact exceeds `MOTION.max_tyre_mps2`, a
    change of velocity of `MOTION.contact_velocity_mps`, and the recording's usual accelerations.
    """
    time = recording.poses.time_s - recording.poses.time_s[0]
    noise = float(np.hypot(*white_noise(recording.poses.values)[:2]))
    place = _without_outliers(time, recording.poses.values[:, :2], LIMITS.outlier_noise_factor * noise)
    n = max(3, round(HALF_WINDOW_S * recording.rate_hz))
    if len(time) < 4 * n:
        return []
    window = np.lib.stride_tricks.sliding_window_view
    t, p = window(time, n), window(place, n, axis=0)
    centred = t - t.mean(axis=1, keepdims=True)
    velocity = np.einsum("kn,kcn->kc", centred, p) / (centred**2).sum(axis=1)[:, None]
    step = velocity[n:] - velocity[:-n]
    lasting = t[n:].mean(axis=1) - t[:-n].mean(axis=1)
    whole = (t[n:, -1] - t[:-n, 0]) < 3.0 * n / recording.rate_hz  # not across a gap
    acceleration = np.where(whole, np.hypot(*step.T) / lasting, 0.0)
    usual = LIMITS.contact_usual_factor * float(np.quantile(acceleration, 0.99))
    limit = np.maximum(LIMITS.contact_velocity_mps / lasting, max(LIMITS.max_tyre_mps2, usual))
    hits, found = np.flatnonzero(acceleration > limit), []
    # hits that follow each other closely are one contact
    for group in np.split(hits, np.flatnonzero(np.diff(time[hits]) > LIMITS.contact_merge_s) + 1) if len(hits) else []:
        a, b = group[0], min(group[-1] + 2 * n, len(time) - 1)
        k = group[int(np.argmax(acceleration[group]))] + n
        count = max(3, round(2.0 * HALF_WINDOW_S * recording.rate_hz))
        change, aside_m = _lasting_change(time, place, (int(a) + n, int(group[-1]) + n), count)
        if change > LIMITS.contact_velocity_mps:
            after = place[(time > time[b]) & (time < time[b] + LIMITS.crash_stop_s)]
            stands = len(after) > 1 and float(np.hypot(*np.ptp(after, axis=0))) < LIMITS.crash_stop_m
            kind = "crash" if stands else "contact"
        elif aside_m > max(LIMITS.min_mounting_step_m, LIMITS.mounting_noise_factor * noise):
            kind = "mounting"
        else:
            continue
        x_m, y_m = map(float, place[k])
        strongest = float(acceleration[group].max())
        found.append(Contact(float(time[a]), float(time[b]), x_m, y_m, kind, strongest, aside_m))
    return found


def _without_outliers(time: Floats, place: Floats, far_m: float) -> Floats:
    """Positions (N, 2) at times (N,) in s, in which each that lies over `far_m` (m) beside its neighbours is moved.

    It is put on the straight line between them; where a neighbour is lost, it stays.
    """
    step_s = np.diff(time)
    near = np.maximum(step_s[1:], step_s[:-1]) < LIMITS.max_gap_periods * np.median(step_s)
    share = (step_s[:-1] / (step_s[:-1] + step_s[1:]))[:, None]
    line = (1.0 - share) * place[:-2] + share * place[2:]
    aside = place[1:-1] - line
    # an outlier puts its neighbours half as far to the other side; a kink in the path does not
    size = (aside**2).sum(axis=1)
    opposite = -(aside[1:] * aside[:-1]).sum(axis=1)
    share_of_it = LIMITS.min_outlier_echo * size
    echoed = (np.r_[opposite, 0.0] > share_of_it) & (np.r_[0.0, opposite] > share_of_it)
    off = near & (size > far_m**2) & echoed
    smooth = place.copy()
    smooth[1:-1][off] = line[off]
    return smooth


def _lasting_change(time: Floats, place: Floats, rows: tuple[int, int], count: int) -> tuple[float, float]:
    """Change of velocity (m/s) across the `rows` (first, end) of a path, and by how much (m) the path steps there.

    The path, positions `place` (N, 2) in m at times `time` (N,) in s, is a straight line in the `count` rows before and
    after them, by medians of slopes that outliers do not reach.  It steps by the least distance of the lines between.
    """
    first, end = rows
    lines = []
    for part in (slice(max(0, first - count), first), slice(end, end + count)):
        t, p = time[part], place[part]
        if len(t) < 3:
            return math.inf, 0.0
        i, j = np.triu_indices(len(t), 1)
        velocity = np.median((p[j] - p[i]) / (t[j] - t[i])[:, None], axis=0)
        lines.append((velocity, np.median(p - t[:, None] * velocity, axis=0)))
    (v_0, p_0), (v_1, p_1) = lines
    between = np.linspace(time[first - 1], time[min(end, len(time) - 1)], BETWEEN)[:, None]
    aside = np.hypot(*((p_1 - p_0) + between * (v_1 - v_0)).T)
    return float(np.hypot(*(v_1 - v_0))), float(aside.min())

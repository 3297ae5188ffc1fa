"""Bumper contacts and crashes: accelerations that no tyre and no motor can give."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.recording.limits import MOTION as LIMITS
from bcid.recording.types import Irregularity, Recording

HALF_WINDOW_S = 0.05  # over which velocity is taken, before an instant and after it


class Contact(NamedTuple):
    """One contact: when (s from the first pose), where, of which kind, and how strong."""

    begin_s: float
    end_s: float
    x_m: float
    y_m: float
    kind: str  # contact, or crash where the car stands afterwards
    acceleration: float  # m/s², the largest


def split_at_contacts(recording: Recording) -> Recording:
    """The recording with a break before and after each contact (bump or crash), so that no segment goes across it."""
    first, odd, breaks = recording.poses.time_s[0], list[Irregularity](), set(recording.breaks_s)
    for c in find_contacts(recording):
        begin_s, end_s = float(first + c.begin_s), float(first + c.end_s)
        # where the track jumps, the acceleration is not the car's
        if any(begin_s <= at <= end_s for at in recording.breaks_s):
            continue
        text = f"at ({c.x_m:.2f}, {c.y_m:.2f}) m, {c.acceleration:.0f} m/s² that no tyre gives: a separate segment"
        odd.append(Irregularity(c.kind, "excluded", 1, f"{begin_s:.3f} to {end_s:.3f} s", text))
        breaks |= {begin_s, end_s}
    return replace(recording, breaks_s=tuple(sorted(breaks)), irregularities=(*recording.irregularities, *odd))


def find_contacts(recording: Recording) -> list[Contact]:
    """The contacts (bumps and crashes) of a recording, in order of time: accelerations that no tyre or motor can give.

    The acceleration at an instant is a finite difference of two velocities, the slopes of lines through the poses
    within HALF_WINDOW_S (at least three poses) before and after it.  A contact exceeds `MOTION.max_tyre_mps2`, a
    change of velocity of `MOTION.contact_velocity_mps`, and the recording's usual accelerations.
    """
    time = recording.poses.time_s - recording.poses.time_s[0]
    place = recording.poses.values[:, :2]
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
        after = place[(time > time[b]) & (time < time[b] + LIMITS.crash_stop_s)]
        stands = len(after) > 1 and float(np.hypot(*np.ptp(after, axis=0))) < LIMITS.crash_stop_m
        kind, (x_m, y_m) = "crash" if stands else "contact", map(float, place[k])
        found.append(Contact(float(time[a]), float(time[b]), x_m, y_m, kind, float(acceleration[group].max())))
    return found

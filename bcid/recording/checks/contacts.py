"""Bumper contacts and crashes: accelerations that no tyre and no motor gives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.recording.types import Recording

HALF_WINDOW_S = 0.05
BUMP_MPS = 0.4  # a change of velocity at once
STRONGEST = 3.0  # m/s^2: what small cars' tyres give at most,
TIMES_USUAL = 2.0  # and so many times what the take shows elsewhere
MERGED_S = 0.5
CRASH_S = 1.0  # after it the car stands: a crash
STANDS_M = 0.05  # further than this it does not come in that time


class Contact(NamedTuple):
    """One contact."""

    begin_s: float
    end_s: float
    x_m: float
    y_m: float
    kind: str  # contact, or crash where the car stands afterwards
    acceleration: float  # m/s^2, the largest


def contacts(recording: Recording) -> list[Contact]:
    """The contacts of a recording, in order.

    Velocity before and after each instant is that of straight lines through the poses within HALF_WINDOW_S (at
    least three poses); the step between the two, over the window, is the acceleration.
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
    limit = np.maximum(BUMP_MPS / lasting, max(STRONGEST, TIMES_USUAL * float(np.quantile(acceleration, 0.99))))
    return _merged(time, place, velocity, acceleration, np.flatnonzero(acceleration > limit), n)


def _merged(time: Floats, place: Floats, velocity: Floats, acceleration: Floats, hits: Ints, n: int) -> list[Contact]:
    found = []
    groups = np.split(hits, np.flatnonzero(np.diff(time[hits]) > MERGED_S) + 1) if len(hits) else []
    for group in groups:
        a, b = group[0], min(group[-1] + 2 * n, len(time) - 1)
        k = group[int(np.argmax(acceleration[group]))] + n
        after = place[(time > time[b]) & (time < time[b] + CRASH_S)]
        stands = len(after) > 1 and float(np.hypot(*np.ptp(after, axis=0))) < STANDS_M
        found.append(
            Contact(
                float(time[a]), float(time[b]), float(place[k, 0]), float(place[k, 1]),
                "crash" if stands else "contact", float(acceleration[group].max()),
            )
        )  # fmt: skip
    return found

"""How the tracked body sits on the car: its yaw against the way that the rear axle goes."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.recording.checks.clock import held_throttle
from bcid.recording.checks.raw_motion import Course, course
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

SLOW = 0.3  # of the fastest, below which the direction is poorly known
GENTLE_MPS2 = 0.3  # lateral acceleration, below which a tyre hardly slips
STRAIGHT_RADPS = 0.2  # yaw rate, below which the front wheel goes where the car does
BLOCK_S = 5.0
MIN_BLOCKS = 6
LARGE_YAW = 0.03  # rad, beyond which an offset is told: a tyre's slip comes to less


class YawOffset(NamedTuple):
    """Tracked yaw minus the car's (rad), with its 95 % interval."""

    rad: float
    low: float
    high: float


def yaw_offset(recording: Recording, vehicle: Vehicle) -> YawOffset | None:
    """The yaw offset at which the rear axle, which is not steered, goes straight ahead when hardly loaded.

    First roughly, by the way the car goes while it hardly turns and the throttle is on.  None where the take has too
    little gentle driving.  Estimated and told, never applied: `mocap.yaw_offset_rad` does that.
    """
    rough = _roughly(recording, vehicle)
    turned = Stream(recording.poses.time_s, recording.poses.values - [0.0, 0.0, rough])
    found = _finely(course(replace(recording, poses=turned), vehicle), vehicle)
    return None if found is None else YawOffset(*(float(np.angle(np.exp(1j * (rough + x)))) for x in found))


def _roughly(recording: Recording, vehicle: Vehicle) -> float:
    motion = course(recording, vehicle)
    if len(motion.time_s) < 2:
        return 0.0
    driven = held_throttle(motion, recording) > 0.0
    use = motion.good & driven & (np.abs(motion.yaw_rate) < STRAIGHT_RADPS)
    use &= motion.v_f > SLOW * np.quantile(motion.v_f, 0.95)
    return -float(np.angle(np.exp(1j * motion.beta_f[use]).sum())) if use.any() else 0.0


def _finely(motion: Course, vehicle: Vehicle) -> YawOffset | None:
    if len(motion.time_s) < 2:
        return None
    wheelbase = vehicle.body.cog_to_front_m + vehicle.body.cog_to_rear_m
    v_x = motion.v_f * np.cos(motion.beta_f)
    v_r = motion.v_f * np.sin(motion.beta_f) - wheelbase * motion.yaw_rate  # at the rear axle, to the left
    use = motion.good & (v_x > SLOW * np.quantile(motion.v_f, 0.95)) & (np.abs(v_x * motion.yaw_rate) < GENTLE_MPS2)
    block = (motion.time_s // BLOCK_S).astype(int)
    slips = [
        float(np.median(np.arctan2(v_r, v_x)[rows]))
        for b in np.unique(block[use])
        if (rows := use & (block == b)).sum() > 0.1 * (block == b).sum()
    ]
    if len(slips) < MIN_BLOCKS:
        return None
    from scipy.stats import bootstrap

    found = bootstrap(
        (-np.array(slips),), np.median, n_resamples=999, rng=np.random.default_rng(0), method="percentile"
    ).confidence_interval
    return YawOffset(-float(np.median(slips)), float(found.low), float(found.high))

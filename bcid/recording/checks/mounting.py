"""How the tracked body is mounted on the car: its yaw against the direction in which the rear axle moves."""

from dataclasses import replace

import numpy as np

from bcid.bootstrap import bootstrap_interval
from bcid.documents.health import YawOffset
from bcid.recording.checks.raw_motion import RawMotion, differentiate_poses
from bcid.recording.limits import MOTION as LIMITS
from bcid.recording.types import Irregularity, Recording, Stream
from bcid.vehicle import Vehicle


def warn_of_yaw_offset(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording with a warning if the tracked body's yaw differs significantly from the car's.

    Significantly means that the offset's 95 % interval lies beyond `MOTION.max_yaw_offset_rad` on one side.
    """
    offset, limit = estimate_yaw_offset(recording, vehicle), LIMITS.max_yaw_offset_rad
    if offset is None or not (offset.low > limit or offset.high < -limit):
        return recording
    apart = f"{offset.low:.3f} to {offset.high:.3f} rad off the way that the rear axle goes"
    value = (vehicle.mocap.yaw_offset_rad or 0.0) + offset.rad
    text = f"the tracked yaw is {apart}: mocap.yaw_offset_rad = {value:.3f} would undo it"
    warning = Irregularity("yaw offset", "warning", 1, recording.sources[0].path, text)
    return replace(recording, irregularities=(*recording.irregularities, warning))


def estimate_yaw_offset(recording: Recording, vehicle: Vehicle) -> YawOffset | None:
    """Yaw of the tracked body minus the car's (rad) and its 95 % interval, such that the rear axle moves along the car.

    Only gentle driving is used, when the unsteered rear axle hardly slips; None where the take has too little of it.
    The poses are not corrected by it; a known offset is corrected by `mocap.yaw_offset_rad` in the vehicle file.
    """
    rough = _rough_yaw_offset(recording, vehicle)
    turned = Stream(recording.poses.time_s, recording.poses.values - [0.0, 0.0, rough])
    fine = _rear_axle_yaw_offset(differentiate_poses(replace(recording, poses=turned), vehicle), vehicle)
    if fine is None:
        return None
    rad, low, high = (float(np.angle(np.exp(1j * (rough + x)))) for x in fine)
    return YawOffset(rad=rad, low=low, high=high)


def _rough_yaw_offset(recording: Recording, vehicle: Vehicle) -> float:
    """First guess of the tracked body's yaw offset (rad): minus the mean angle from its yaw to the direction of motion.

    Only nearly straight, fast driving under throttle is used; 0 where there is none.
    """
    motion = differentiate_poses(recording, vehicle)
    if len(motion.time_s) < 2 or not motion.good.any():
        return 0.0
    driven = recording.commands.held_at(motion.time_s)[:, 1] > 0.0
    use = motion.good & driven & (np.abs(motion.yaw_rate) < LIMITS.max_mounting_yaw_rate_radps)
    use &= motion.v_f > LIMITS.min_mounting_speed_share * np.quantile(motion.v_f[motion.good], 0.95)
    return -float(np.angle(np.exp(1j * motion.beta_f[use]).sum())) if use.any() else 0.0


def _rear_axle_yaw_offset(motion: RawMotion, vehicle: Vehicle) -> tuple[float, float, float] | None:
    """Yaw offset of the tracked body (rad) and the ends of its 95 % interval by block bootstrap; None without data.

    It is minus the median, over blocks of the take, of the rear axle's slip angle in gentle driving, when that axle
    hardly slips; at least `MOTION.min_mounting_blocks` blocks must have enough of it.
    """
    if len(motion.time_s) < 2 or not motion.good.any():
        return None
    v_x = motion.v_f * np.cos(motion.beta_f)
    v_ry = motion.v_f * np.sin(motion.beta_f) - vehicle.body.wheelbase_m * motion.yaw_rate
    use = motion.good & (v_x > LIMITS.min_mounting_speed_share * np.quantile(motion.v_f[motion.good], 0.95))
    use &= np.abs(v_x * motion.yaw_rate) < LIMITS.max_mounting_lateral_mps2
    _, block = np.unique(motion.time_s // LIMITS.mounting_block_s, return_inverse=True)
    lengths, used = np.bincount(block), np.bincount(block[use], minlength=block.max() + 1)
    slip = np.arctan2(v_ry, v_x)[use]
    order = np.argsort(block[use], kind="stable")
    parts = np.split(slip[order], np.cumsum(used)[:-1])
    slips = [
        float(np.median(part))
        for part, length in zip(parts, lengths, strict=True)
        if len(part) > LIMITS.min_mounting_block_share * length
    ]
    if len(slips) < LIMITS.min_mounting_blocks:
        return None
    return -float(np.median(slips)), *bootstrap_interval(-np.array(slips), np.median)

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
    """The recording with a warning where the tracked body surely has another yaw than the car."""
    offset, limit = estimate_yaw_offset(recording, vehicle), LIMITS.max_yaw_offset_rad
    if offset is None or not (offset.low > limit or offset.high < -limit):
        return recording
    apart = f"{offset.low:.3f} to {offset.high:.3f} rad off the way that the rear axle goes"
    text = f"the tracked yaw is {apart}: mocap.yaw_offset_rad = {offset.rad:.3f} would undo it"
    warning = Irregularity("yaw offset", "warning", 1, recording.sources[0].path, text)
    return replace(recording, irregularities=(*recording.irregularities, warning))


def estimate_yaw_offset(recording: Recording, vehicle: Vehicle) -> YawOffset | None:
    """The yaw offset at which the rear axle, which is not steered, moves straight ahead when hardly loaded.

    None where the take has too little gentle driving. It is only reported: `mocap.yaw_offset_rad` applies a known one.
    """
    rough = _rough_yaw_offset(recording, vehicle)
    turned = Stream(recording.poses.time_s, recording.poses.values - [0.0, 0.0, rough])
    fine = _rear_axle_yaw_offset(differentiate_poses(replace(recording, poses=turned), vehicle), vehicle)
    if fine is None:
        return None
    rad, low, high = (float(np.angle(np.exp(1j * (rough + x)))) for x in fine)
    return YawOffset(rad=rad, low=low, high=high)


def _rough_yaw_offset(recording: Recording, vehicle: Vehicle) -> float:
    """A first yaw offset (rad), at which the car moves ahead while it hardly turns and the throttle is on."""
    motion = differentiate_poses(recording, vehicle)
    if len(motion.time_s) < 2:
        return 0.0
    driven = recording.commands.held_at(motion.time_s)[:, 1] > 0.0
    use = motion.good & driven & (np.abs(motion.yaw_rate) < LIMITS.max_mounting_yaw_rate_radps)
    use &= motion.v_f > LIMITS.min_mounting_speed_share * np.quantile(motion.v_f, 0.95)
    return -float(np.angle(np.exp(1j * motion.beta_f[use]).sum())) if use.any() else 0.0


def _rear_axle_yaw_offset(motion: RawMotion, vehicle: Vehicle) -> tuple[float, float, float] | None:
    """The median over blocks of minus the rear axle's slip angle (rad) in gentle driving, and its 95 % interval."""
    if len(motion.time_s) < 2:
        return None
    v_x = motion.v_f * np.cos(motion.beta_f)
    v_ry = motion.v_f * np.sin(motion.beta_f) - vehicle.body.wheelbase_m * motion.yaw_rate
    use = motion.good & (v_x > LIMITS.min_mounting_speed_share * np.quantile(motion.v_f, 0.95))
    use &= np.abs(v_x * motion.yaw_rate) < LIMITS.max_mounting_lateral_mps2
    block = (motion.time_s // LIMITS.mounting_block_s).astype(int)
    slips = [
        float(np.median(np.arctan2(v_ry, v_x)[rows]))
        for b in np.unique(block[use])
        if (rows := use & (block == b)).sum() > LIMITS.min_mounting_block_share * (block == b).sum()
    ]
    if len(slips) < LIMITS.min_mounting_blocks:
        return None
    return -float(np.median(slips)), *bootstrap_interval(-np.array(slips), np.median)

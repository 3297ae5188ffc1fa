"""Whether poses can be a car's at all: noise that hides its motion, a yaw that does not follow its path."""

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.known import poses_known_at
from bcid.recording.checks.limits import AGREEMENT as LIMITS
from bcid.recording.checks.pose_noise import white_noise_sd
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

YAW_GAINS = {0.5: "half of it", 1.0 / (2.0 * np.pi): "turns", 2.0: "twice of it"}
"""What a yaw may be that turns by such a factor of the path."""


def judge_poses(recording: Recording, vehicle: Vehicle) -> str | None:
    """The verdict on poses that cannot be fitted: a cause and what mends it; None on all others."""
    t, pose = recording.poses.time_s, recording.poses.values
    grid = np.arange(t[0], t[-1], 1.0 / recording.rate_hz)
    if len(grid) < 5 * recording.rate_hz:
        return None
    x, y, yaw = (np.interp(grid, t, column) for column in pose.T)
    known = poses_known_at(recording, grid, 0.5 / recording.rate_hz)
    noise = max(white_noise_sd(x, known), white_noise_sd(y, known))
    coarse = np.arange(t[0], t[-1], LIMITS.course_s)
    X, Y = (np.interp(coarse, t, column) for column in pose.T[:2])
    step = np.hypot(np.diff(X), np.diff(Y)) / LIMITS.course_s
    seen = poses_known_at(recording, 0.5 * (coarse[1:] + coarse[:-1]), 0.5 * LIMITS.course_s)
    if not seen.any():
        return None
    speed = float(np.quantile(step[seen], 0.7))
    count = max(2.0, LIMITS.period_s * recording.rate_hz)
    speed_noise = noise * np.sqrt(12.0 / count) / LIMITS.period_s
    hides_motion = speed_noise > LIMITS.max_speed_noise * speed
    if hides_motion or noise > LIMITS.max_place_noise * vehicle.body.wheelbase_m:
        return (
            f"the positions scatter by {1e3 * noise:.0f} mm, so that the speed over {LIMITS.period_s:g} s is known to "
            f"{speed_noise:.2g} m/s where the car drives {speed:.2g} m/s: mostly noise; calibrate the tracking, and "
            "drive again"
        )
    moving = seen & (step > 0.3 * float(np.quantile(step[seen], 0.95)))
    course = np.unwrap(np.arctan2(np.diff(Y), np.diff(X)))
    path_turn = float(np.sum(np.abs(np.diff(course))[moving[1:] & moving[:-1]]))
    if path_turn > LIMITS.least_path_turn_rad and float(np.ptp(yaw)) < LIMITS.standing_yaw_rad:
        return (
            f"the yaw stays at {float(np.median(yaw)):.3g} rad while the path turns by {path_turn:.0f} rad: the "
            "orientation is not logged; give yaw_rad (or the quaternion) of the tracked body"
        )
    together = moving[1:] & moving[:-1]
    yaw_turn = np.diff(np.interp(0.5 * (coarse[1:] + coarse[:-1]), t, pose[:, 2]))[together]
    path_turns = np.abs(np.diff(course))[together]
    if len(path_turns) and float(np.median(np.abs(yaw_turn))) > LIMITS.degrees_turn * float(np.median(path_turns)):
        return "the yaw turns some 57 times as far as the path: it is in degrees, not rad; map it with gain = 0.017453"
    return _judge_yaw_gain(yaw_turn, np.diff(course)[together])


def _judge_yaw_gain(yaw_turn: Floats, path_turn: Floats) -> str | None:
    """The verdict on a yaw that turns by another factor than the path; both (N,) in rad, from row to row.

    Over a whole drive both turn alike, however the body is mounted: what is summed up along the path lies on a line of
    slope 1, but for how the car slips and is steered.  Where the course turns round at once the car goes back, and
    nothing is compared.  Nothing is judged of a wheel that is steered so far that they do not lie on a line.
    """
    use = np.abs(path_turn) < LIMITS.turns_round_rad
    turned, path = np.cumsum(yaw_turn[use]), np.cumsum(path_turn[use])
    if not len(path) or float(np.ptp(path)) < LIMITS.least_compared_turn_rad:
        return None
    slope = float(np.polyfit(path, turned, 1)[0])
    left = float(np.var(turned - slope * path) / max(float(np.var(turned)), 1e-12))
    if 1.0 / LIMITS.yaw_gain < slope < LIMITS.yaw_gain or left > LIMITS.unlike_turns:
        return None
    gain, what = min(YAW_GAINS.items(), key=lambda known: abs(np.log(known[0] / abs(slope))))
    known = abs(np.log(gain / abs(slope))) < np.log(LIMITS.known_yaw_gain)
    how = f"map it with gain = {np.sign(slope) / gain if known else 1.0 / slope:.3g}, or log it in rad"
    return f"the yaw turns {slope:.3g} times as far as the path: {what if known else 'another unit'}? {how}"

"""A take's health: whether it is worth fitting, judged while its car still stands in the arena."""

import numpy as np

from bcid.aliases import Bools
from bcid.documents.health import HealthFigures, RefusalProblem, TakeHealth
from bcid.errors import InputRefused
from bcid.recording.checks.mounting import estimate_yaw_offset
from bcid.recording.checks.raw_motion import RawMotion, differentiate_poses
from bcid.recording.limits import HEALTH as LIMITS
from bcid.recording.types import BRAKE_CHANNEL, Recording
from bcid.vehicle import Vehicle


def refused_health(refusal: InputRefused) -> TakeHealth:
    """The health verdict "no-go" of a take whose file is refused, with the problems that `refusal` names."""
    why = "; ".join(f"{p.place}: {p.cause}" for p in refusal.problems)
    problems = tuple(RefusalProblem(**p._asdict()) for p in refusal.problems)
    return TakeHealth(go=False, sentence=f"no-go: refused, {why}", refused=str(refusal), problems=problems)


def assess_health(recording: Recording, vehicle: Vehicle) -> TakeHealth:
    """Whether a take is worth fitting: "go", or "no-go" with reasons; and what a fit of it could not identify.

    It is judged by motion time, coverage of poses and commands, and variety of driving (`HEALTH`).
    """
    motion = differentiate_poses(recording, vehicle)
    moving = motion.good & (motion.v_f > LIMITS.min_moving_speed * vehicle.body.wheelbase_m)
    figures = _health_figures(recording, vehicle, motion, moving)
    not_excited = _find_unexcited_constants(recording, vehicle, motion, moving)
    verdicts = [i.detail for i in recording.irregularities if i.action == "no-go"]
    against = []
    if figures.moving_s < LIMITS.min_motion_s:
        against.append(f"the car moves for {figures.moving_s:.0f} s only, {LIMITS.min_motion_s:.0f} s are the least")
    if figures.pose_coverage < LIMITS.min_coverage:
        known = f"the pose is known in {figures.pose_coverage:.0%} of the take"
        against.append(f"{known}, {LIMITS.min_coverage:.0%} are the least")
    if figures.command_coverage < LIMITS.min_coverage:
        against.append(f"commands are known in {figures.command_coverage:.0%} of the take")
    if any(text.startswith("steering") for text in not_excited):
        against.append("it shows straight driving only")
    if verdicts:
        sentence = f"no-go: {' | '.join(verdicts)}"
    elif against:
        sentence = f"no-go: {'; '.join(against)}; drive it again"
    else:
        sentence = f"go: {figures.moving_s:.0f} s of motion, the pose known in {figures.pose_coverage:.0%}"
        if not_excited:
            sentence += f"; it will not show {', '.join(text.partition(': ')[2] for text in not_excited)}"
    findings = [f"{i.kind}, {i.action} {i.count} times at {i.where}: {i.detail}" for i in recording.irregularities]
    return TakeHealth(
        go=not (verdicts or against), sentence=sentence, reasons_against=(*verdicts, *against),
        not_excited=tuple(not_excited), findings=tuple(findings), figures=figures, clock=recording.clock,
        lost=any(i.kind == "lost" for i in recording.irregularities),
    )  # fmt: skip


def _health_figures(recording: Recording, vehicle: Vehicle, motion: RawMotion, moving: Bools) -> HealthFigures:
    """Duration, time in motion, coverage by poses and commands, top speed and yaw offset of a take.

    `moving` (N,) marks the rows of `motion` in which the car moves.
    """
    frames = max(1.0, (recording.duration_s - _paused_s(recording)) * recording.rate_hz + 1.0)
    pose_s, command_s = recording.poses.time_s, recording.commands.time_s
    row = np.searchsorted(command_s, pose_s, side="right") - 1
    holds = (row >= 0) & (pose_s - command_s[np.maximum(row, 0)] <= recording.hold_s)
    return HealthFigures(
        duration_s=recording.duration_s,
        moving_s=float(moving.sum() * motion.step_s),
        pose_coverage=min(1.0, len(recording.poses) / frames),
        command_coverage=float(holds.mean()),
        top_speed_mps=float(np.quantile(motion.v_f[moving], 0.99)) if moving.any() else 0.0,
        yaw_offset_rad=estimate_yaw_offset(recording, vehicle),
    )


def _paused_s(recording: Recording) -> float:
    """Time (s) in which neither poses nor commands were recorded, in pauses of over `HEALTH.min_pause_s`."""
    pose_s, command_s = recording.poses.time_s, recording.commands.time_s
    inside = command_s[(command_s > pose_s[0]) & (command_s < pose_s[-1])]
    steps = np.diff(np.union1d(pose_s, inside))
    return float(steps[steps > LIMITS.min_pause_s].sum())


def _find_unexcited_constants(recording: Recording, vehicle: Vehicle, motion: RawMotion, moving: Bools) -> list[str]:
    """Kinds of driving that a take lacks (steering, other speeds, braking), with the constants each would identify."""
    if not moving.any():
        return []
    u_s, u_m = recording.commands.held_at(motion.time_s).T
    found, v = [], motion.v_f[moving]
    gentle = np.quantile(np.abs(v * motion.yaw_rate[moving]), 0.95) < LIMITS.min_lateral_mps2
    if gentle and np.quantile(np.abs(u_s[moving]), 0.95) < LIMITS.min_steering_rad:
        found.append("steering: cornering stiffness, grip and inertia (C_f, C_r, F_f_max, F_r_max, I_z)")
    if np.quantile(v, 0.95) - np.quantile(v, 0.05) < LIMITS.min_speed_spread * np.quantile(v, 0.95):
        found.append("other speeds: motor and drag apart (K_t, R_1, R_2)")
    braked = recording.driven.held_at(motion.time_s)[:, 2] > 0.0
    if not vehicle.motor.reverses:
        braked |= u_m < 0.0
    brakes = not vehicle.motor.reverses or BRAKE_CHANNEL in recording.channels
    if vehicle.motor.law == "speed" and brakes and braked[moving].sum() * motion.step_s < LIMITS.min_braking_s:
        found.append("braking: the brake gain (K_b)")
    return found

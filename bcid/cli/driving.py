"""A saved model, driven from rest by a commands file and recorded as a lab would record it."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.cli.limits import LIMITS
from bcid.errors import InputRefused, UsageError
from bcid.estimate.command_parts import cut_into_parts, mean_commands
from bcid.evaluation.closed_loop import integrate_poses
from bcid.evaluation.intervals import predict_with_interval
from bcid.evaluation.validity import ModelValidity, load_validity
from bcid.files.outputs import MayReplace, refuse_to_overwrite, staged_outputs
from bcid.files.parquet import write_columns
from bcid.models.interface import ContinuousTimeModel, Model, RolloutDiverged, history_at_rest, rollout
from bcid.models.saving import load_model
from bcid.recording.formats.commands_file import read_commands_file
from bcid.recording.types import Stream
from bcid.simulation.car import Sensor
from bcid.simulation.drive import COMMAND_HZ, Drive
from bcid.simulation.samples import SampleTake
from bcid.simulation.writing import write_mcap_take, write_motive_take

# step (s) of a model in continuous time, and of poses between the steps of any model
STEP_S = 0.005
PREDICTION_UNITS = {
    "time": "s", "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s",
    "v_x_low": "m/s", "v_y_low": "m/s", "yaw_rate_low": "rad/s",
    "v_x_high": "m/s", "v_y_high": "m/s", "yaw_rate_high": "rad/s",
}  # fmt: skip
NOISE_FIELDS = ("position_noise", "yaw_noise")
_TIME_DECIMALS = 7


def check_only_noise_is_set(changes: Sequence[str]) -> None:
    """Raise `UsageError` unless each change NAME=VALUE sets `position_noise` or `yaw_noise` of the motion capture."""
    others = [c for c in changes if c.partition("=")[0] not in NOISE_FIELDS]
    if others:
        raise UsageError(
            f"--set {others[0]}: a saved model is driven as it is\n  next: set {' or '.join(NOISE_FIELDS)} only"
        )


def write_model_drive(
    folder: Path, take: SampleTake, model: Path, commands: Path, sensor: Sensor, seed: int, may_replace: MayReplace
) -> tuple[list[Path], list[str]]:
    """Drive the saved model in the folder `model`; write its recording, and its predicted twists with 95 % intervals.

    Returns the paths written into `folder`, and warnings for people.  A take of 0 s lasts as long as the commands.

    Raises:
        UsageError: the commands file would be written over.
        InputRefused: there is no such model, the commands cannot be driven, the model leaves the finite numbers, or a
            file is there already that `may_replace` does not allow to replace.
    """
    recording, *others = take.files()
    prediction = f"{take.name}.prediction.parquet"
    targets = [folder / name for name in (recording, *others, prediction)]
    if any(target.resolve() == commands.resolve() for target in targets):
        raise UsageError(f"{commands} would be written over\n  next: name the take otherwise, or another --out")
    refuse_to_overwrite(targets, may_replace)
    saved, validity = load_model(model), load_validity(model)
    take_commands = read_commands_file(commands)
    time_s, command = take_commands.command_time_s, take_commands.command
    if not (np.isfinite(time_s).all() and np.isfinite(command).all()) or np.any(np.diff(time_s) <= 0.0):
        cause = "holds blank cells, or times that do not increase"
        raise InputRefused(commands, "commands file", cause, "write a time and two numbers in every row")
    usual = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    duration_s = take.duration_s or float(time_s[-1]) + usual
    if not LIMITS.min_drive_s <= duration_s <= LIMITS.max_drive_s:
        cause = f"lasts {duration_s:g} s"
        allowed = f"{LIMITS.min_drive_s:g} to {LIMITS.max_drive_s:g} s"
        raise InputRefused(commands, "time_s", cause, f"drive {allowed}, or give --duration")
    begin = saved.period_s * np.arange(math.ceil(duration_s / saved.period_s - 1e-6), dtype=np.float64)
    parts = cut_into_parts(*_held_commands(time_s, command, duration_s), begin, saved.period_s)
    try:
        run = drive_model(saved, time_s, command, duration_s, sensor, seed)
        twist = rollout(saved, history_at_rest(saved.lags), parts)
    except RolloutDiverged as error:
        raise InputRefused(model, "model.json", f"{error} under {commands.name}", "drive it more gently") from None
    with staged_outputs(folder, may_replace) as staged:
        (write_mcap_take if take.format == "mcap" else write_motive_take)(staged / recording, run, sensor.rate_hz, seed)
        if validity is None:
            written = [recording]
            warnings = ["no limits.json beside the model: neither intervals nor the range of its data are known"]
        else:
            written = [recording, prediction]
            warnings = _write_prediction(staged / prediction, saved, validity, parts, twist, seed)
    return [folder / name for name in written], warnings


def _write_prediction(
    path: Path, model: Model, validity: ModelValidity, parts: Floats, twist: Floats, seed: int
) -> list[str]:
    """Write predicted twists [v_x, v_y, yaw rate] (N + 1, 3) with 95 % intervals as Parquet; returns warnings.

    The intervals come from samples of the model's process noise under the commands `parts` (N, W, 4).
    """
    warnings, half_width = [], np.full((len(parts), 3), np.nan)
    if validity.noise is not None:
        rest = history_at_rest(model.lags)
        half_width = predict_with_interval(model, rest, parts, validity.noise, seed=seed).half_width
    if not np.isfinite(half_width).all():
        warnings.append("no intervals: its process noise is not known, or its rollouts run away")
    half = np.vstack([np.zeros((1, 3)), half_width])
    times = model.period_s * np.arange(len(twist))
    write_columns(path, np.column_stack([times, twist, twist - half, twist + half]), PREDICTION_UNITS)
    driven = mean_commands(parts)
    exits = [e.describe(model.period_s) for e in validity.range.first_exits(twist, np.vstack([driven, driven[-1:]]))]
    if exits:
        warnings.append(f"beyond the data it was fitted on: {'; '.join(exits)}")
    return warnings


def _held_commands(time_s: Floats, command: Floats, duration_s: float) -> tuple[Floats, Floats]:
    """Times (M,) and commands (M, 2) of a drive of `duration_s` (s) that begins with zero commands where none is given.

    Each of `command` (K, 2) holds from its time in `time_s` (K,), and each is repeated COMMAND_HZ times a second, as
    controllers do.
    """
    times: Floats = np.asarray(np.round(np.r_[-1.0, time_s], _TIME_DECIMALS), dtype=np.float64)
    given = Stream(times, np.vstack([np.zeros(2), command]))
    repeats: Floats = np.arange(math.ceil(duration_s * COMMAND_HZ - 1e-6)) / COMMAND_HZ
    inside = time_s[(time_s >= 0.0) & (time_s < duration_s)]
    logged: Floats = np.unique(np.round(np.r_[repeats, inside], _TIME_DECIMALS))
    return logged, given.held_at(logged)


def drive_model(model: Model, time_s: Floats, command: Floats, duration_s: float, sensor: Sensor, seed: int) -> Drive:
    """Drive a model from rest under commands [steering, throttle] (M, 2), each held from its time in `time_s` (M,) on.

    Poses are sampled at the sensor's rate, with its noise.  Commands are zero before the first.
    """
    if isinstance(model, ContinuousTimeModel):
        model = model.with_period(STEP_S)
    h = model.period_s
    logged_s, logged = _held_commands(time_s, command, duration_s)
    begin = h * np.arange(math.ceil(duration_s / h - 1e-6), dtype=np.float64)
    twist = rollout(model, history_at_rest(model.lags), cut_into_parts(logged_s, logged, begin, h))
    fine = np.arange(math.floor(len(begin) * h / STEP_S + 1e-6) + 1) * STEP_S
    edges = np.append(begin, len(begin) * h)
    pose = integrate_poses(np.zeros(3), np.column_stack([np.interp(fine, edges, c) for c in twist.T]), STEP_S)
    frame = np.arange(math.floor(duration_s * sensor.rate_hz + 1e-9) + 1)
    seen = np.column_stack([np.interp(frame / sensor.rate_hz, fine, c) for c in pose.T])
    noise = np.array([sensor.position_noise, sensor.position_noise, sensor.yaw_noise])
    seen += noise * np.random.default_rng(seed).standard_normal(seen.shape)
    return Drive(logged_s, logged, frame, seen, np.empty((0, 8)))

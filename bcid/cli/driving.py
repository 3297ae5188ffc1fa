"""A saved model driven by a commands file from rest at the origin, recorded as a lab would."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.cli.options import LONGEST_S
from bcid.errors import InputRefused, UsageError
from bcid.evaluation.closed_loop import integrate
from bcid.evaluation.limits import load_limits
from bcid.evaluation.uncertainty import predicted
from bcid.files.parquet import write_columns
from bcid.models.interface import Continuous, Diverged, Model, at_rest, rollout
from bcid.models.saving import load_model
from bcid.recording.formats.commands_file import read_commands
from bcid.simulation.car import Sensor
from bcid.simulation.drive import COMMAND_HZ, Drive
from bcid.simulation.samples import Take
from bcid.simulation.writing import write_mcap, write_motive

STEP_S = 0.005  # of a model that may take any, and of the poses between a model's own steps
PREDICTION = {
    "time": "s", "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s",
    "v_x_low": "m/s", "v_y_low": "m/s", "yaw_rate_low": "rad/s",
    "v_x_high": "m/s", "v_y_high": "m/s", "yaw_rate_high": "rad/s",
}  # fmt: skip
NOISE = ("position_noise", "yaw_noise")
_TIME_DECIMALS = 7


def check_noise_alone(changes: Sequence[str]) -> None:
    """Raise `UsageError` where NAME=VALUE would change more than the noise of the motion capture."""
    others = [c for c in changes if c.partition("=")[0] not in NOISE]
    if others:
        raise UsageError(f"--set {others[0]}: a saved model is driven as it is\n  next: set {' or '.join(NOISE)} only")


class Driven(NamedTuple):
    """What was written, and what is to be said of it."""

    paths: list[Path]  # the recording and, where the model knows how sure it is, the prediction
    warnings: list[str]


def write_driven(folder: Path, take: Take, model: Path, commands: Path, sensor: Sensor, seed: int) -> Driven:
    """Drive the model saved in the folder `model` and write the take, and its prediction with 95 % intervals.

    A take of 0 s lasts as long as the commands.

    Raises:
        InputRefused: no such model, commands that cannot be driven, or a model that leaves the finite numbers.
    """
    path = folder / f"{take.name}.{'mcap' if take.format == 'mcap' else 'csv'}"
    if path.with_suffix(".commands.csv").resolve() == commands.resolve():
        raise UsageError(f"{commands} would be written over\n  next: name the take otherwise, or another --out")
    saved, limits = load_model(model), load_limits(model)
    _, time_s, command, _, _ = read_commands(commands)
    if not (np.isfinite(time_s).all() and np.isfinite(command).all()) or np.any(np.diff(time_s) <= 0.0):
        cause = "holds blank cells, or times that do not increase"
        raise InputRefused(commands, "commands file", cause, "write a time and two numbers in every row")
    usual = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    duration_s = take.duration_s or float(time_s[-1]) + usual
    if not 1.0 <= duration_s <= LONGEST_S:
        cause = f"lasts {duration_s:g} s"
        raise InputRefused(commands, "time_s", cause, f"drive 1 to {LONGEST_S:g} s, or give --duration")
    given = _given(time_s, command, duration_s, saved.period_s)
    try:
        run = driven(saved, time_s, command, duration_s, sensor, seed)
        twist = rollout(saved, at_rest(saved.lags), given)
    except Diverged as error:
        raise InputRefused(model, "model.json", f"{error} under {commands.name}", "drive it more gently") from None
    folder.mkdir(parents=True, exist_ok=True)
    (write_mcap if take.format == "mcap" else write_motive)(path, run, sensor.rate_hz, seed)
    if limits is None:
        return Driven(
            [path], ["no limits.json beside the model: neither intervals nor the range of its data are known"]
        )
    warnings, half, end = [], np.zeros((1, 3)), np.full((len(given), 3), np.nan)
    if limits.noise is not None:
        end = predicted(saved, at_rest(saved.lags), given, limits.noise, seed=seed).half
    if not np.isfinite(end).all():
        warnings.append("no intervals: its process noise is not known, or its rollouts run away")
    half = np.vstack([half, end])
    prediction = folder / f"{take.name}.prediction.parquet"
    times = saved.period_s * np.arange(len(twist))
    write_columns(prediction, np.column_stack([times, twist, twist - half, twist + half]), PREDICTION)
    beyond = [b.words(saved.period_s) for b in limits.range.beyond(twist, np.vstack([given, given[-1:]]))]
    if beyond:
        warnings.append(f"beyond the data it was fitted on: {'; '.join(beyond)}")
    return Driven([path, prediction], warnings)


def _given(time_s: Floats, command: Floats, duration_s: float, h: float) -> Floats:
    """The command (N, 2) in force when each step of `h` begins; nothing is commanded before the first."""
    begin = np.round(np.arange(math.ceil(duration_s / h - 1e-6)) * h, _TIME_DECIMALS)
    rows = np.searchsorted(np.round(time_s, _TIME_DECIMALS), begin, side="right") - 1
    return np.where(rows[:, None] >= 0, command[np.maximum(rows, 0)], 0.0)


def driven(model: Model, time_s: Floats, command: Floats, duration_s: float, sensor: Sensor, seed: int) -> Drive:
    """The drive under commands (M, 2) held from their times (M,) on, with the sensor's noise.

    What is written as commanded is what the model was given: commands count from the step that begins next, and
    nothing is commanded before the first.
    """
    if isinstance(model, Continuous):
        model = model.in_steps_of(STEP_S)
    h = model.period_s
    given = _given(time_s, command, duration_s, h)
    begin = np.round(np.arange(len(given)) * h, _TIME_DECIMALS)
    twist = rollout(model, at_rest(model.lags), given)
    fine = np.arange(math.floor(len(begin) * h / STEP_S + 1e-6) + 1) * STEP_S
    edges = np.append(begin, len(begin) * h)
    pose = integrate(np.zeros(3), np.column_stack([np.interp(fine, edges, c) for c in twist.T]), STEP_S)
    frame = np.arange(math.floor(duration_s * sensor.rate_hz + 1e-9) + 1)
    seen = np.column_stack([np.interp(frame / sensor.rate_hz, fine, c) for c in pose.T])
    noise = np.array([sensor.position_noise, sensor.position_noise, sensor.yaw_noise])
    seen += noise * np.random.default_rng(seed).standard_normal(seen.shape)
    told = np.r_[True, (np.diff(given, axis=0) != 0.0).any(axis=1)]
    told[:: max(1, round(1.0 / (COMMAND_HZ * h)))] = True
    return Drive(begin[told], given[told], frame, seen, np.empty((0, 8)))

"""Recordings of one car fitted each by itself, pooled, and what they say written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from bcid.aliases import Progress
from bcid.documents.pool import PoolDocument, PooledAlternative, PooledConstant, PooledFactor, PooledRecording
from bcid.errors import InputRefused
from bcid.estimate.saving import load_estimate
from bcid.estimate.types import Estimate
from bcid.evaluation.seen_takes import TakeSteps, read_take_steps
from bcid.execution.jobs import Workers, run_jobs
from bcid.fleet.attempts import Attempt, attempt, describe_lost_process
from bcid.fleet.pooled_car import CarSummary, PooledCar, summarise_fit, weigh_alternatives
from bcid.fleet.repeats import find_repeats
from bcid.likelihood.divergence import refuse_divergence
from bcid.likelihood.hypothesis import DRAG
from bcid.likelihood.prepare import base_hypothesis, prepare_and_fit_base
from bcid.models.newton_euler.initial_guess import guess_car
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import constant_units
from bcid.models.saving import save_model
from bcid.pipeline.config import PipelineConfig
from bcid.pipeline.run import Pipeline
from bcid.pipeline.watching import NotingWatcher
from bcid.recording.saving import load_recording
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

REPORT_FIT = "fit this one by `bcid fit --model newton-euler --loss poses` with BCID_TRACEBACK=1, and report it"


class FittedRecording(NamedTuple):
    """One recording's part in a pool."""

    name: str
    duration_s: float
    summary: CarSummary
    notes: tuple[str, ...] = ()  # what a person should know of the way to it


def fit_recording(recording: Recording, estimate: Estimate, vehicle: Vehicle) -> FittedRecording:
    """Fit the base model to the poses of one recording, and keep what it says of the constants.

    Raises:
        InputRefused: too little of the recording can be used, or no model can follow it.
    """
    start = guess_car([estimate], vehicle, *estimate.steering_constants())
    hypothesis = base_hypothesis(vehicle, start, [estimate])
    with refuse_divergence([recording]):
        _, _, (fit, _) = prepare_and_fit_base([recording], [estimate], hypothesis, ())
    return FittedRecording(estimate.name, recording.duration_s, summarise_fit(fit))


def tell_drives_apart(work: Pipeline, paths: Sequence[Path]) -> dict[Path, TakeSteps]:
    """By which of its steps the drive of each recording is known.

    Raises:
        InputRefused: two recordings are of the same drive, at least in part.
    """
    takes = {path: read_take_steps(work.ingest(path).folder).keep_some() for path in paths}
    for later, first in find_repeats(dict(enumerate(takes.values()))).items():
        cause = f"{paths[later]} is {paths[first]} once more, or a part of it: the same drive"
        raise InputRefused(work.config.source, "recordings", cause, "name each drive once")
    return takes


def fit_recordings(
    work: Pipeline, paths: Sequence[Path], workers: Workers, progress: Progress = lambda share, text: None
) -> dict[Path, Attempt[FittedRecording]]:
    """Fit the base model to each recording at `paths`, several at a time; what each gave, or why it failed.

    The estimator is tuned to each by itself, as by `bcid fleet`, so that no process holds the motion of more than one.
    """
    made = dict[Path, Attempt[FittedRecording]]()

    def prepare(path: Path) -> Callable[[], Attempt[FittedRecording]]:
        return partial(estimate_and_fit, work.config.for_recording(Path.cwd(), path), work.names[path])

    def lose(path: Path) -> Attempt[FittedRecording]:
        return Attempt(None, [describe_lost_process(f"fit {work.names[path]}")])

    for path, result in run_jobs(paths, prepare, workers, lose):
        made[path] = result
        progress(len(made) / len(paths), work.names[path])
    return {path: made[path] for path in paths}


def estimate_and_fit(config: PipelineConfig, name: str) -> Attempt[FittedRecording]:
    """Estimate the motion of the one recording of `config`, and fit the base model to it, in whatever process."""
    (path,), watcher = config.training, NotingWatcher()

    def estimate() -> tuple[Recording, Estimate, Vehicle]:
        work = Pipeline(config, watcher)
        work.refuse_unusable([path])  # it may have been written to since all were looked at
        return load_recording(work.ingest(path).folder), load_estimate(work.estimate(path).folder), work.vehicle

    read, problems = attempt(f"estimate {name}", estimate)
    if read is None:
        return Attempt(None, problems)
    notes = tuple(watcher.notes)
    return attempt(f"fit {name}", lambda: fit_recording(*read)._replace(name=name, notes=notes), REPORT_FIT)


def save_pooled_model(pooled: PooledCar, period_s: float, folder: Path) -> None:
    """Save the car that the recordings have in common as a newton-euler model in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    facts = {"optimiser": "pooled over recordings", "loss": "poses"}
    save_model(NewtonEuler(pooled.car(), period_s, facts), folder)


def describe_pool(
    pooled: PooledCar, fitted: Sequence[FittedRecording], reference: Sequence[int], vehicle: Vehicle
) -> PoolDocument:
    """What recordings say together; `reference` are those with which all are compared."""
    factors, sd = pooled.factors(reference)
    car, units, k = pooled.car(), constant_units(pooled.car()), len(pooled.names)
    se = pooled.pooled.shared_sd
    constants = []
    for i, symbol in enumerate(pooled.symbols):
        value = float(getattr(car, symbol))
        error = float(se[i]) * (1.0 if symbol in DRAG else value)
        scatter = float(pooled.pooled.spread[k + i])
        constants.append(
            PooledConstant(symbol=symbol, value=value, se=error, unit=units.get(symbol, ""), scatter=scatter)
        )
    recordings = tuple(
        PooledRecording(
            name=each.name, duration_s=each.duration_s, reference=i in reference,
            factors=tuple(
                PooledFactor(name=name, factor=float(factors[i, j]), se=float(factors[i, j] * sd[i, j]))
                for j, name in enumerate(pooled.names)
            ),
        )
        for i, each in enumerate(fitted)
    )  # fmt: skip
    spreads = dict(zip(pooled.names, pooled.pooled.spread[:k].tolist(), strict=True))
    alternatives = tuple(
        PooledAlternative(named=a.named, other=a.other, nats=round(a.nats, 2))
        for a in weigh_alternatives([each.summary for each in fitted], pooled)
    )
    return PoolDocument(
        vehicle=vehicle.name, constants=tuple(constants), recordings=recordings, spreads=spreads,
        alternatives=alternatives,
    )  # fmt: skip

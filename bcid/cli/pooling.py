"""`bcid pool`: recordings of one car learnt from together, and how its load, motor or grip differ between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bcid.cli import options
from bcid.cli.options import Format
from bcid.errors import InputRefused, PartLost, Problems, UsageError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bcid.documents.pool import PoolDocument
    from bcid.evaluation.seen_takes import TakeSteps
    from bcid.fleet.attempts import Attempt
    from bcid.fleet.pool_recordings import FittedRecording
    from bcid.fleet.pooled_car import PooledCar
    from bcid.pipeline.config import PipelineConfig

RESULT, MODEL = "pool.json", "pooled"


def pool(
    recordings: options.RecordingsArgument = None,
    own: Annotated[
        list[str] | None,
        typer.Option(
            "--own", show_default="mass",
            help="What may differ from recording to recording; repeat for several: mass, load, motor, grip, drag.",
        ),
    ] = None,
    reference: Annotated[
        list[Path] | None,
        typer.Option("--reference", help="The recordings that all are compared with.", show_default="the first"),
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=0, help="Recordings that are fitted at a time; 0 for as many as there are cores.")
    ] = 0,
    dask: options.DaskOption = None,
    pipeline: options.PipelineOption = None,
    vehicle: options.VehicleOption = None,
    out: options.OutOption = None,
    commands: options.CommandsOption = None,
    allow_partial: options.AllowPartialOption = False,
    ignore_health: options.IgnoreHealthOption = False,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:  # fmt: skip
    """Fit one car to many recordings, and say how its load, motor, grip or drag differ from one to the next."""
    from bcid.cli.sink import Sink
    from bcid.fleet.pool_recordings import describe_pool, fit_recordings, tell_drives_apart
    from bcid.fleet.pooled_car import pool_car, refuse_to_pool
    from bcid.pipeline.named_models import MODEL_FILES, MODELS_FOLDER
    from bcid.pipeline.run import Pipeline
    from bcid.store.receipt import refuse_to_renew

    sink, workers, differing = Sink(format), options.choose_workers(jobs, dask), own or ["mass"]
    config = options.read_config(
        pipeline, recordings, vehicle, out, commands, allow_partial, force, ignore_health, sink.note
    )
    paths = list(dict.fromkeys(config.recordings()))
    refuse_to_pool(len(paths), differing)
    compared = _find_references(reference or [], paths)
    home = config.workspace / MODELS_FOLDER / MODEL
    refuse_to_renew(config.workspace, [RESULT, *(f"{MODELS_FOLDER}/{MODEL}/{file}" for file in MODEL_FILES)], force)
    work, problems = Pipeline(config, sink), Problems()
    for path in paths:
        # all are looked at before the first is fitted: what minutes have fitted is not thrown away for one of them
        with problems.gather_refusals():
            work.refuse_unusable([path])
    problems.raise_if_any(paths[0])
    takes = tell_drives_apart(work, paths)
    with sink.stage(f"fit {len(paths)} recordings") as progress:
        made = fit_recordings(work, paths, workers, progress)
    lost = [f"{p.stage}: {p.text}" for each in made.values() for p in each.problems]
    _refuse_lost_fits(made, compared)
    fitted = {path: each.result for path, each in made.items() if each.result is not None}
    with sink.stage("pool"):
        pooled = pool_car([each.summary for each in fitted.values()], differing)
        document = describe_pool(
            pooled, list(fitted.values()), [list(fitted).index(path) for path in compared], work.vehicle
        )
    _write_results(document, pooled, [takes[path] for path in fitted], config, force)
    sink.result(document.as_json(), lambda: _tables(document))
    notes = [f"{work.names[path]}: {text}" for path, each in fitted.items() for text in each.notes]
    for text in (*notes, *doubts_of_factors(document)):
        sink.note(text)
    sink.note(f"the car of all: {home}\nwritten to: {config.workspace / RESULT}")
    try:
        work.raise_if_parts_lost()
    except PartLost as part:
        lost.append(str(part))
    if lost:
        raise PartLost("\n".join([f"{len(made) - len(fitted)} of {len(paths)} recordings are not pooled", *lost]))


def _write_results(
    document: PoolDocument, pooled: PooledCar, seen: Sequence[TakeSteps], config: PipelineConfig, force: bool
) -> None:
    """Write pool.json, and the car of all as a model, made from the takes `seen`; with `force` over anything."""
    from bcid.evaluation.seen_takes import FILE_NAME as SEEN_TAKES
    from bcid.evaluation.seen_takes import save_seen_takes
    from bcid.fleet.pool_recordings import save_pooled_model
    from bcid.models.saving import FILES
    from bcid.pipeline.named_models import MODEL_FILES, MODELS_FOLDER
    from bcid.store.receipt import renew_results

    for file in MODEL_FILES:
        # with --force: what is said there of another model is not true of this one
        if file not in (FILES[0], SEEN_TAKES):
            (config.workspace / MODELS_FOLDER / MODEL / file).unlink(missing_ok=True)
    writers = {
        RESULT: document.write,
        f"{MODELS_FOLDER}/{MODEL}/{FILES[0]}": lambda path: save_pooled_model(
            pooled, config.estimate.period_s, path.parent
        ),
        f"{MODELS_FOLDER}/{MODEL}/{SEEN_TAKES}": lambda path: save_seen_takes(seen, path.parent),
    }
    renew_results(config.workspace, writers, force)


def _refuse_lost_fits(made: Mapping[Path, Attempt[FittedRecording]], compared: Sequence[Path]) -> None:
    """Raise `InputRefused` where one of those `compared` with could not be fitted, or fewer than two of several are."""
    failed = {path: each.problems[0] for path, each in made.items() if each.problems}
    for path in (*(path for path in compared if path in failed), *failed):
        if path in compared:
            why, other = "is what all are compared with", "name another with --reference"
        elif len(made) - len(failed) < 2:
            why, other = "leaves fewer than two to be pooled", "name more recordings"
        else:
            continue
        cause, _, step = failed[path].text.partition("\n  next: ")
        raise InputRefused(path, failed[path].stage, f"{why}: {cause}", f"{step}; or {other}")


def _find_references(reference: Sequence[Path], paths: Sequence[Path]) -> list[Path]:
    """Those among `paths` with which all recordings are compared; the first where none is named."""
    known = {path.absolute(): path for path in paths}
    if missing := [path for path in reference if path.absolute() not in known]:
        raise UsageError(
            f"--reference names a recording that is not pooled: {missing[0]}\n  next: name it among the recordings, too"
        )
    return list(dict.fromkeys(known[path.absolute()] for path in reference)) or [paths[0]]


def doubts_of_factors(document: PoolDocument) -> list[str]:
    """What may as well differ between the recordings in the place of each factor, a sentence for each."""
    from bcid.fleet.limits import LIMITS
    from bcid.report.formats import join_words

    sentences = []
    for named in document.spreads:
        near = [a for a in document.alternatives if a.named == named and a.nats > -LIMITS.twin_nats]
        if not near:
            continue
        best, alike = near[0], [a.other for a in near if a.nats > near[0].nats - LIMITS.twin_nats]
        if best.nats > LIMITS.twin_nats:
            how = f"are {best.nats:.0f} nats likelier if {join_words(alike, 'or')} differs in its place (--own)"
        else:
            how = f"do not tell it from {join_words([a.other for a in near], 'or')}"
        sentences.append(f"{named}: the recordings {how}")
    return sentences


def _tables(document: PoolDocument) -> RenderableType:
    """How the recordings differ, and the constants that they share."""
    from rich.console import Group

    from bcid.cli.sink import plain_table
    from bcid.report.formats import format_with_error

    names = list(document.spreads)
    rows = [
        [r.name + (" (reference)" if r.reference else ""), f"{r.duration_s:.0f} s"]
        + [format_with_error(f.factor, f.se) for f in r.factors]
        for r in document.recordings
    ]
    constants = [
        [c.symbol, f"{format_with_error(c.value, c.se)} {c.unit}", f"{100.0 * c.scatter:.1f} %"]
        for c in document.constants
    ]
    return Group(
        plain_table("factors beside the reference", ["recording", "length", *names], rows),
        plain_table(
            "constants that all share", ["constant", "value", "scatter"], constants,
            "scatter: from recording to recording, beside what the factors say",
        ),
    )  # fmt: skip

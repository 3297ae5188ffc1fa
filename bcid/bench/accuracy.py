"""How well our models, and those that a user would fit instead, predict takes that they have not seen."""

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from bcid.bench.limits import ACCURACY
from bcid.bench.peers import PEERS
from bcid.bench.run import SCHEMA
from bcid.estimate.saving import load_estimate
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import nmse, predict_whole_take, predict_with_restarts
from bcid.evaluation.intervals import HORIZONS_S
from bcid.execution.jobs import Workers, run_jobs
from bcid.files.source_code import stage_code
from bcid.files.toml import PathText, Settings, read_toml
from bcid.models.fitting.windows import inverse_spread
from bcid.models.interface import SupportsRollout
from bcid.models.saving import load_model
from bcid.pipeline.config import PipelineConfig, read_pipeline_file
from bcid.pipeline.run import Pipeline
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.samples import VEHICLE, SampleTake, write_sample_take

HORIZON_NAMES = (*(f"{h:g} s" for h in HORIZONS_S), "end")
# After the simulated hour both networks on kinematics must be below the white box, and all three below a goal.
HOUR, SMALLEST = "simulated hour", ("newton-euler", "k-mlp", "k-sindy-mlp")


class DataSet(Settings):
    """The takes of one vehicle: recorded ones, or a simulated drive of `simulated_s` seconds."""

    name: str
    vehicle: PathText | None = None
    training: list[PathText] = Field(default_factory=list)
    validation: PathText | None = None
    simulated_s: Annotated[float, Field(gt=0)] | None = None
    validation_s: Annotated[float, Field(gt=0)] = 110.0
    seed: int = 1


class AccuracyFile(Settings):
    """The file of data sets, and the pipeline file whose settings all fits share."""

    pipeline: PathText
    data: list[DataSet]


def read_accuracy_file(path: Path, recordings: Path | None, out: Path) -> Iterator[tuple[str, PipelineConfig]]:
    """Yield (name, pipeline configuration) of each data set in an accuracy benchmark's TOML file `path`.

    Simulated drives are written, and the artifacts of the pipeline kept, under `out`.  Data sets of real recordings are
    skipped where `recordings`, the folder that holds them, is None.
    """
    file = read_toml(path, AccuracyFile, "accuracy file", "pipelines/accuracy.toml is one")
    usual = read_pipeline_file(path.parent / file.pipeline)
    for data in file.data:
        if data.simulated_s is not None:
            vehicle, training, validation = _write_simulated_takes(data, out / "simulated")
        elif recordings is not None and data.vehicle is not None and data.validation is not None:
            vehicle, training = path.parent / data.vehicle, tuple(recordings / p for p in data.training)
            validation = recordings / data.validation
        else:
            continue
        yield data.name, usual.model_copy(update={
            "vehicle": vehicle, "training": training, "validation": validation, "truth": None,
            "workspace": out / "workspace", "diagnose": (),
        })  # fmt: skip


def _write_simulated_takes(data: DataSet, folder: Path) -> tuple[Path, tuple[Path, ...], Path]:
    """Write a simulated car's vehicle file, training and validation recordings (MCAP) to `folder`; return the paths.

    A recording that an earlier run wrote with the same seed, length and simulation code is kept.
    """
    vehicle, paths = folder / "bumper_car.toml", []
    code = stage_code("bcid.simulation.samples").digest[:8]  # takes of another simulation are others
    for k, (name, seconds) in enumerate((("training", data.simulated_s or 0.0), ("validation", data.validation_s))):
        take = SampleTake(f"{name}_{data.seed}_{seconds:.0f}s_{code}", "mcap", seconds)
        path = folder / f"{take.name}.mcap"
        if not path.exists():
            made = write_sample_take(folder / "unfinished", take, Plant(**REAL_EXTRAS), Sensor(), 1000 * data.seed + k)
            made.replace(path)
        paths.append(path)
    vehicle.write_text(VEHICLE, encoding="utf-8")
    return vehicle, (paths[0],), paths[1]


class AccuracyFit(NamedTuple):
    """One fit of the benchmark: of a model of ours, or of a package's, with a seed."""

    number: int
    seed: int
    model: str = ""
    package: str = ""  # a key of PEERS; empty for a model of ours


def compare_models(
    name: str, config: PipelineConfig, seeds: Sequence[int], workers: Workers = 1
) -> Iterator[dict[str, Any]]:
    """Yield a row for each seed and model with the normalised mean square error (NMSE) of its twists by horizon.

    Models are those that `config` fits ("ours": True) and those of the PEERS that are installed.  All are fitted to
    the training recordings and scored on the validation recording, so many at a time, or on a cluster, as `workers`
    says; rows come in the same order either way.  A peer whose fit raises gives a row with "error".
    """
    # where others work, too, paths have to hold there
    places = {key: getattr(config, key).absolute() for key in ("vehicle", "workspace", "validation")}
    config = config.model_copy(update={**places, "training": [path.absolute() for path in config.training]})
    work = Pipeline(config)
    for recording in config.recordings():  # once, before several processes need it
        work.estimate(recording)
    packages = [package for package in PEERS if find_spec(package) is not None]
    wanted = [
        (seed, *kind) for seed in seeds for kind in (*((m, "") for m in config.models), *(("", p) for p in packages))
    ]
    fits = [AccuracyFit(number, *each) for number, each in enumerate(wanted)]
    ended, following = dict[int, dict[str, Any]](), 0
    for fit, row in run_jobs(fits, lambda fit: partial(_fit_and_score, name, config, fit), workers):
        ended[fit.number] = row
        while following in ended:
            yield ended.pop(following)
            following += 1


def _fit_and_score(name: str, config: PipelineConfig, fit: AccuracyFit) -> dict[str, Any]:
    """The row of one fit on the data set called `name`."""
    work = Pipeline(config.model_copy(update={"seed": fit.seed}))
    training = [load_estimate(work.estimate(p).folder) for p in config.training]
    take = load_estimate(work.estimate(config.recordings()[-1]).folder)
    weights = inverse_spread(np.concatenate([e.twist for e in training]))
    training_s = sum(len(e) * e.period_s for e in training)
    row: dict[str, Any] = {"data": name, "training_s": training_s, "validation": take.name}
    if not fit.package:
        row |= {"model": fit.model, "ours": True, "seed": fit.seed}
        return row | _score_horizons(load_model(work.fit(fit.model).folder), take, weights)
    kind, begin = PEERS[fit.package], time.perf_counter()
    row |= {"model": kind.name, "ours": False, "seed": fit.seed}
    try:
        peer = kind.fit(training, fit.seed)
    except Exception as error:  # whatever another library raises is reported, and the others go on
        return row | {"error": f"{type(error).__name__}: {error}", "horizons": dict.fromkeys(HORIZON_NAMES)}
    return row | {"fit_s": time.perf_counter() - begin} | _score_horizons(peer, take, weights)


def _score_horizons(model: SupportsRollout, take: Estimate, weights: Any) -> dict[str, Any]:
    """NMSE of the twists that a model predicts on a take: {"horizons": {name: {"nmse", "ci95"}}} by HORIZON_NAMES.

    Predictions restart from the estimate every 0.5, 2 or 10 s, or run through the whole take ("end").  Rows at which
    one restarts are not scored; a horizon at which one diverges has None.  `weights` (3,) are 1/sd of the twist.
    """
    scores = {}
    for name, horizon in zip(HORIZON_NAMES, (*HORIZONS_S, None), strict=True):
        if horizon is None:
            twist, rows = predict_whole_take(model, take), np.ones(len(take), dtype=bool)
        else:
            again = predict_with_restarts(model, take, horizon)
            twist, rows = again.twist, ~again.start
        finite = bool(np.isfinite(twist).all())
        value = nmse(twist[rows], take.twist[rows], weights, take.period_s) if finite else None
        scores[name] = value and {"nmse": value.mean, "ci95": list(value.ci95)}
    return {"horizons": scores}


def summarise_accuracy(rows: Sequence[Mapping[str, Any]], about: Mapping[str, Any]) -> dict[str, Any]:
    """The accuracy benchmark's JSON: a table of median NMSE and spread over seeds, the goals missed, and all `rows`.

    `rows` are those of `compare_models`.  The table has a line for each data set and model; its "spread" is (largest -
    smallest NMSE) / median.  The fields of `about` are taken over as they are.
    """
    table = []
    for data in dict.fromkeys(r["data"] for r in rows):
        mine = [r for r in rows if r["data"] == data]
        for model in dict.fromkeys(r["model"] for r in mine):
            runs = [r for r in mine if r["model"] == model]
            line: dict[str, Any] = {"data": data, "model": model, "ours": runs[0]["ours"], "seeds": len(runs)}
            for horizon in runs[0]["horizons"]:
                scores = [r["horizons"][horizon] for r in runs]
                values = sorted(filter(None, scores), key=itemgetter("nmse"))
                whole = len(values) == len(runs)  # no seed's rollout diverges
                middle = values[(len(values) - 1) // 2] if whole else {"nmse": None, "ci95": None}
                known = whole and len(values) > 1
                spread = (values[-1]["nmse"] - values[0]["nmse"]) / middle["nmse"] if known else None
                line[horizon] = {**middle, "spread": spread}
            table.append(line)
    return {
        "schema": SCHEMA, "what": "accuracy", **about, "table": table, "missed": _missed_goals(table),
        "rows": list(rows),
    }  # fmt: skip


def _missed_goals(table: Sequence[Mapping[str, Any]]) -> list[str]:
    """Sentences on where a model of ours diverges, changes with the seed, or has a higher NMSE than a peer's model.

    `table` is that of `summarise_accuracy`.  On the data set HOUR each model in SMALLEST must beat every peer, stay
    below `ACCURACY.max_hour_nmse` and, unless it is Newton-Euler, beat that; elsewhere our best must beat the peers.
    """
    missed, horizons = [], [k for k in table[0] if isinstance(table[0][k], Mapping)]
    for data in dict.fromkeys(line["data"] for line in table):
        lines = {line["model"]: line for line in table if line["data"] == data}
        ours = [m for m, line in lines.items() if line["ours"]]
        for model in ours:
            missed += [f"{data}, {model}: diverges ({h})" for h in horizons if lines[model][h]["nmse"] is None]
            change = lines[model]["end"]["spread"]
            if change is not None and change > ACCURACY.max_seed_change:
                missed.append(f"{data}, {model}: seeds change {100 * change:.0f} % at the end")
        compared = [m for m in SMALLEST if m in lines] if data == HOUR else []
        for h in horizons:
            errors = {m: line[h]["nmse"] or np.inf for m, line in lines.items()}
            peer = min((m for m in lines if m not in ours), key=errors.__getitem__, default=None)
            if peer is None:
                continue
            for model in compared or [min(ours, key=errors.__getitem__)]:
                if errors[peer] < errors[model]:
                    missed.append(f"{data}, {h}: {peer} {1e3 * errors[peer]:.2f}, {model} {1e3 * errors[model]:.2f}")
        end = {m: lines[m]["end"]["nmse"] or np.inf for m in compared}
        missed += [f"{data}: {m} is not below newton-euler" for m in compared[1:] if end[m] >= end[SMALLEST[0]]]
        goal = ACCURACY.max_hour_nmse
        missed += [f"{data}: {m} is above {1e3 * goal:g}" for m in compared if end[m] >= goal]
    return missed

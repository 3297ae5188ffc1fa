"""The commands about missing physics: diagnose, plan, prove."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bcid.cli.options import (
    AllowPartialOption,
    CommandsOption,
    FormatOption,
    OutOption,
    PipelineOption,
    Recordings,
    VehicleOption,
    end,
    plan_of,
)
from bcid.cli.sink import Format, Sink, table
from bcid.errors import GoalMissed, UsageError
from bcid.pipeline.run import Pipeline
from bcid.vehicle import read_vehicle

if TYPE_CHECKING:
    from bcid.proof.blind.blind_test import Blind

USUAL_SEED = 1
LONG = 100  # takes of a blind test, from which it is said that they take hours
PUBLISHED = ("diagnosis.html", "diagnosis.json", "model", "next_manoeuvre.commands.csv")


def diagnose(
    recordings: Recordings = None,
    pipeline: PipelineOption = None,
    vehicle: VehicleOption = None,
    out: OutOption = None,
    commands: CommandsOption = None,
    simulation: Annotated[
        str | None,
        typer.Option(
            help="What to compare with: a saved newton-euler model's folder, a TOML file of its parameters, another "
            "simulator's recording of the same car, or module:function; the default refits newton-euler on the "
            "recordings.",
        ),
    ] = None,
    allow_partial: AllowPartialOption = False,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Say what physics the recordings show that the model lacks, and prove it on held-out blocks."""
    from bcid.cli import show

    sink = Sink(format)
    work = Pipeline(plan_of(pipeline, recordings, vehicle, out, commands, allow_partial), sink)
    artifact = work.diagnose(simulation)
    page = work.publish(artifact, *PUBLISHED, to="" if recordings else "diagnosis")
    found = artifact.json("diagnosis.json")
    sink.result(found, lambda: show.diagnosis(found))
    sink.note(f"page: {page}\nmodel: {page.parent / 'model'} (bcid report --model, bcid simulate --model)")
    end(work)


def plan(
    vehicle: Annotated[Path, typer.Option("--vehicle", help="The vehicle file.")],
    effects: Annotated[list[str] | None, typer.Argument(help="Effects that are to show; all if none is named.")] = None,
    out: Annotated[Path, typer.Option("--out", help="The command file to write.")] = Path("plan.commands.csv"),
    arena: Annotated[tuple[float, float], typer.Option(help="Length and width of the arena in metres.")] = (12.0, 7.0),
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Say what to drive so that the asked effects become detectable in this arena, and write its commands."""
    from bcid.effects.table import EFFECTS, effect_of
    from bcid.experiment.manoeuvres import Arena, write_commands
    from bcid.experiment.plan import NOMINAL, largest_throttle, nominal_car
    from bcid.experiment.plan import plan as planned
    from bcid.likelihood.prepare import constants_of

    asked = [effect_of(name).id for name in effects or EFFECTS]
    of, sink = read_vehicle(vehicle), Sink(format)
    omitted = {"T_s": of.steering.time_constant_s, "d": of.steering.max_rate_radps}
    unknown = tuple(s for s, given in omitted.items() if given is None)
    with sink.stage("plan"):
        found = planned(
            nominal_car(of), constants_of(of), of.steering.max_angle_rad, NOMINAL, asked, Arena(*arena),
            largest_throttle(of), unknown,
        )  # fmt: skip
    if not found.parts:
        raise UsageError(f"no manoeuvre fits {arena[0]:g} by {arena[1]:g} m\n  next: give the --arena that is free")
    write_commands(out, found)
    parts: list[dict[str, Any]] = [
        {
            "name": p.drive.name, "begin_s": p.begin_s, "seconds": p.drive.seconds,
            "start": [float(v) for v in p.drive.start],
        }
        for p in found.parts
    ]  # fmt: skip
    smallest = {
        e: None if sizes is None else {k: {"value": v, "unit": u} for k, (v, u) in sizes.items()}
        for e, sizes in found.smallest.items()
    }
    data = {
        "schema": "bcid.plan/1", "file": str(out), "minutes": found.minutes, "parts": parts, "smallest": smallest,
        "missing": found.missing,
    }  # fmt: skip
    columns = ["drive", "from", "lasts", "start x, y, yaw (m, m, rad)"]
    rows = [
        [p["name"], f"{p['begin_s']:.0f} s", f"{p['seconds']:.0f} s", ", ".join(f"{v:.2f}" for v in p["start"])]
        for p in parts
    ]
    missing = "; ".join(f"{e}: {why}" for e, why in found.missing.items())
    title = f"{found.minutes:.1f} minutes in {out}"
    sink.result(data, lambda: table(title, columns, rows, f"not shown by any drive: {missing}" if missing else ""))


def prove(
    out: Annotated[Path, typer.Option("--out", help="The folder for results; a second run with the same goes on.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Eighteen cases of ten tiers, and the baselines: some eight minutes.")
    ] = False,
    seed: Annotated[
        int | None, typer.Option(help="Random seed of what is concealed, drivers and noise; 1 unless given.")
    ] = None,
    salt: Annotated[
        str, typer.Option(help="A secret text: a digest of it and all answers is printed before the run.")
    ] = "",
    repeats: Annotated[int, typer.Option(min=1, help="Takes that conceal one effect, of every effect.")] = 3,
    nulls: Annotated[int, typer.Option(min=0, help="Takes that conceal nothing.")] = 300,
    imperfect_nulls: Annotated[
        int, typer.Option(min=0, help="The same of a car that the base model does not fit.")
    ] = 100,
    pairs: Annotated[int, typer.Option(min=0, help="Takes that conceal two effects.")] = 50,
    every: Annotated[int, typer.Option(min=1, help="Run every so many cases of each tier only.")] = 1,
    case: Annotated[
        str | None,
        typer.Option(help="Only write this case's recording, vehicle file and answer; as the page names it."),
    ] = None,
    baselines: Annotated[
        bool, typer.Option("--baselines", help="Run other methods on the same takes; diagnoses all of them again.")
    ] = False,
    minutes: Annotated[
        float | None, typer.Option(min=0.0, help="Begin no further case after so many; a second run goes on.")
    ] = None,
    workers: Annotated[int, typer.Option(min=0, help="Cases at a time; 0 for as many as there are cores.")] = 0,
    real: Annotated[
        Path | None,
        typer.Option(help="A TOML file of questions to real recordings (pipelines/dart/cases.toml), to ask instead."),
    ] = None,
    recordings: Annotated[Path | None, typer.Option(help="Where these recordings are.")] = None,
    format: FormatOption = Format.human,  # noqa: A002
) -> None:
    """Conceal effects in takes and count what the diagnosis makes of them; resumable, hours unless --quick."""
    if real is None:
        _go_together(quick, seed, salt, every, recordings)
        if case is not None and (salt or baselines or minutes is not None):
            raise UsageError("--case: only writes a recording\n  next: leave out --salt, --baselines and --minutes")
    from bcid.proof.blind.blind_test import Blind, Sizes

    sink, workers = Sink(format), workers or os.cpu_count() or 1
    sizes = Sizes(repeats, nulls, imperfect_nulls, pairs, every)
    if real is not None:
        concealed = {
            "quick": quick, "case": case is not None, "seed": seed is not None, "salt": salt, "baselines": baselines,
            "minutes": minutes is not None, "repeats, --nulls, --imperfect-nulls, --pairs or --every": sizes != Sizes(),
        }  # fmt: skip
        given = [f"--{name}" for name, is_given in concealed.items() if is_given]
        if given:
            raise UsageError(f"{', '.join(given)}: of concealed cases\n  next: leave it out with --real")
        _prove_real(real, recordings or Path(), out, workers, sink)
        return
    test = Blind(USUAL_SEED if seed is None else seed, salt, quick, sizes, quick or baselines)
    if case is None:
        _prove(test, out, workers, minutes, sink)
    else:
        _write_case(test, case, out, sink)


def _go_together(quick: bool, seed: int | None, salt: str, every: int, recordings: Path | None) -> None:
    """Raise `UsageError` where options of concealed cases do not go together."""
    if recordings is not None:
        raise UsageError("--recordings: of questions to real ones\n  next: name their file with --real")
    if quick and every != 1:
        raise UsageError("--quick is a part of its own\n  next: leave out --every")
    if salt and seed in (None, USUAL_SEED):
        told = "--salt: seals nothing, whoever knows the usual seed knows the answers"
        raise UsageError(f"{told}\n  next: draw one and keep it to yourself until the run has ended, --seed N")


def _write_case(test: Blind, name: str, out: Path, sink: Sink) -> None:
    """One case's recording."""
    from bcid.proof.blind.blind_test import laid_out

    chosen = next((c for c in test.cases if c.name == name), None)
    if chosen is None:
        some = f"such as {test.cases[0].name}"
        raise UsageError(f"--case {name}: seed {test.seed} has no such case\n  next: name one that it has, {some}")
    path = laid_out(chosen, out)
    data = {"recording": str(path), "vehicle": str(out / "bumper_car.toml"), "left_out": list(chosen.left_out)}
    sink.result(data, lambda: str(path))
    sink.note(f"next: bcid diagnose {path} --vehicle {data['vehicle']}; the answer lies beside it")
    if chosen.left_out:
        sink.note(f"the blind test left out {', '.join(chosen.left_out)}; that command does not, and may name them")


def _prove(test: Blind, out: Path, workers: int, minutes: float | None, sink: Sink) -> None:
    """The outcome of a blind test, as JSON and page."""
    from bcid.cli import show
    from bcid.proof.blind.blind_test import blind_test
    from bcid.report.proof_page import write_proof_page

    def sealed(seal: str | None) -> None:
        if seal:
            sink.told(f"seal of {len(test.cases)} answers: {seal}")
        else:
            sink.note(
                f"not sealed: whoever knows the seed ({test.seed}) knows the answers; --salt and a new --seed seal them"
            )
        if not test.quick and minutes is None and len(test.cases) > LONG:
            sink.note(f"{len(test.cases)} takes are some hours' work; it goes on where it was left, --minutes ends it")

    with sink.stage("prove") as progress:
        found = blind_test(
            test, out, workers, minutes, sealed,
            lambda done: progress(done / len(test.cases), f"{done} of {len(test.cases)}"),
        )  # fmt: skip
    (out / "prove.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    write_proof_page(found, out / "prove.html")
    sink.result(found, lambda: show.proof(found))
    sink.note(f"page: {out / 'prove.html'}")
    if found["missed"]:
        short = "; ".join(found["missed"])
        raise GoalMissed(f"goals missed ({short})\n  next: see what was answered wrongly in {out / 'prove.html'}")


def _prove_real(file: Path, recordings: Path, out: Path, workers: int, sink: Sink) -> None:
    """Every question to real recordings, counted."""
    from bcid.cli import show
    from bcid.proof.real.run_questions import code_of_rows, run_real
    from bcid.proof.real.scoring import outcome

    rows: list[dict[str, Any]] = []
    with sink.stage("prove on real recordings") as progress:
        for row, share in run_real(file, recordings, out, workers):
            rows.append(row)
            progress(share, row["case"])
    found = outcome(rows, code_of_rows())
    (out / "real.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    sink.result(found, lambda: show.real_proof(found))
    wrong = [f"{r['tier']} {r['case']}" for r in rows if not r["right"]]
    if wrong:
        raise GoalMissed(f"goals missed ({'; '.join(wrong)})\n  next: see their rows in {out / 'real.json'}")

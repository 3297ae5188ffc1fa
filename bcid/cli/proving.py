"""`bcid prove`: what a diagnosis finds of concealed effects and of known real ones; whether it hangs on a limit."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bcid.cli import options
from bcid.cli.limits import LIMITS
from bcid.cli.options import Format
from bcid.errors import GoalMissed, UsageError

if TYPE_CHECKING:
    from bcid.cli.sink import Sink
    from bcid.execution.jobs import Workers
    from bcid.proof.blind.blind_test import BlindTest

DEFAULT_SEED = 1
BLIND_FILES = ("prove.json", "prove.html")
REAL_FILE = "real.json"
LIMITS_FILE = "limits.json"


def prove(
    out: Annotated[Path, typer.Option("--out", help="The folder for results; a second run there continues.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Run twenty cases of twelve tiers, and --baselines: some ten minutes.")
    ] = False,
    seed: Annotated[
        int | None, typer.Option(help="Random seed of concealed effects, drivers and noise. Default: 1.")
    ] = None,
    salt: Annotated[
        str, typer.Option(help="A secret text; a digest of it and of all answers is printed before the run.")
    ] = "",
    repeats: Annotated[int, typer.Option(min=1, help="Takes for each effect that conceal it alone.")] = 3,
    nulls: Annotated[int, typer.Option(min=0, help="Takes that conceal nothing.")] = 300,
    imperfect_nulls: Annotated[
        int, typer.Option(min=0, help="Takes that conceal nothing, of a car that the base model does not fit.")
    ] = 100,
    pairs: Annotated[int, typer.Option(min=0, help="Takes that conceal two effects.")] = 50,
    tricycles: Annotated[
        int, typer.Option(min=0, help="Takes of tricycles, forward and backward, that conceal one effect or two.")
    ] = 40,
    other_laws: Annotated[
        int, typer.Option(min=0, help="Takes of small cars of other formulas than published; as many less an effect.")
    ] = 40,
    other_day: Annotated[
        int, typer.Option(min=0, help="Takes of small cars on another day than published; as many less an effect.")
    ] = 40,
    every: Annotated[int, typer.Option(min=1, help="Run only every N-th case of each tier.")] = 1,
    case: Annotated[
        str | None, typer.Option(help="Only write the recording, vehicle file and answer of the case of this name.")
    ] = None,
    baselines: Annotated[
        bool, typer.Option("--baselines", help="Run other methods on the same takes; all are diagnosed again.")
    ] = False,
    minutes: Annotated[
        float | None, typer.Option(min=0.0, help="Time after which no further case begins; a second run continues.")
    ] = None,
    workers: Annotated[
        int, typer.Option(min=0, help="Cases that run at a time; 0 for as many as there are cores.")
    ] = 0,
    dask: options.DaskOption = None,
    real: Annotated[
        list[Path] | None,
        typer.Option(
            help="A TOML file of questions to real recordings to ask instead (pipelines/dart/cases.toml); repeatable."
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(help="Ask only the questions of --real whose kind, recording, name or variation has this text."),
    ] = None,
    recordings: Annotated[Path | None, typer.Option(help="The folder of the recordings for --real.")] = None,
    limits: Annotated[
        bool,
        typer.Option("--limits", help="Halve and double each limit instead, and count verdicts that change."),
    ] = False,
    takes: Annotated[
        int | None, typer.Option(min=1, max=60, help="Takes of the panel for --limits. Default: all 60.")
    ] = None,
    force: options.ForceOption = False,
    format: options.FormatOption = Format.human,  # noqa: A002
) -> None:
    """Conceal effects in simulated takes and count how many the diagnosis finds; takes hours unless --quick."""
    if only and not real:
        raise UsageError("--only goes with --real\n  next: name a file of questions with --real")
    if not real and not limits:
        _check_blind_options(quick, seed, salt, every, recordings)
        if case is not None and (salt or baselines or minutes is not None):
            raise UsageError("--case only writes a recording\n  next: leave out --salt, --baselines and --minutes")
    if takes is not None and not limits:
        raise UsageError("--takes goes with --limits\n  next: add --limits, or leave it out")
    from bcid.cli.sink import Sink
    from bcid.proof.blind.blind_test import BlindTest, SuiteSizes

    sink, places = Sink(format), options.choose_workers(workers, dask)
    sizes = SuiteSizes(repeats, nulls, imperfect_nulls, pairs, every, other_laws, other_day, tricycles)
    suite = "repeats, --nulls, --imperfect-nulls, --pairs, --other-laws, --other-day, --tricycles or --every"
    for_blind_tests = {
        "quick": quick, "case": case is not None, "salt": salt, "baselines": baselines, suite: sizes != SuiteSizes(),
        "dask": dask is not None,
    }  # fmt: skip
    processes = workers or os.cpu_count() or 1
    if limits:
        _refuse_options({"real": bool(real), "recordings": recordings is not None, **for_blind_tests}, "limits")
        _vary_limits(DEFAULT_SEED if seed is None else seed, takes, out, processes, minutes, sink, force)
        return
    if real:
        _refuse_options({"seed": seed is not None, "minutes": minutes is not None, **for_blind_tests}, "real")
        _ask_real_questions(real, recordings or Path(), only or (), out, processes, sink, force)
        return
    test = BlindTest(DEFAULT_SEED if seed is None else seed, salt, quick, sizes, quick or baselines)
    if case is None:
        _run_blind_test(test, out, places, minutes, sink, force)
    else:
        _write_case(test, case, out, sink, force)


def _refuse_options(options_given: Mapping[str, object], other: str) -> None:
    """Raise `UsageError` where options, given by name with whether they were used, go with no run for --`other`."""
    given = [f"--{name}" for name, is_given in options_given.items() if is_given]
    if given:
        why = "for the blind test only" if other == "real" else "not for the panel on which limits are varied"
        raise UsageError(f"{', '.join(given)}: {why}\n  next: leave it out with --{other}")


def _check_blind_options(quick: bool, seed: int | None, salt: str, every: int, recordings: Path | None) -> None:
    """Raise `UsageError` where options of a blind test (simulated takes that conceal effects) contradict."""
    if recordings is not None:
        raise UsageError("--recordings goes with --real\n  next: name a file of questions with --real")
    if quick and every != 1:
        raise UsageError("--quick chooses its own cases\n  next: leave out --every")
    if salt and seed in (None, DEFAULT_SEED):
        raise UsageError(
            "--salt seals nothing with the default seed, from which anybody can draw the answers\n"
            "  next: choose a --seed and keep it to yourself until the run has ended"
        )


def _write_case(test: BlindTest, name: str, out: Path, sink: Sink, force: bool) -> None:
    """Write the simulated take `name` of a blind test into `out`: recording, vehicle file and concealed effects."""
    from bcid.files.outputs import staged_outputs
    from bcid.proof.blind.blind_test import write_case_files
    from bcid.proof.blind.small_files import SIMULATION_FILE

    chosen = next((c for c in test.cases if c.name == name), None)
    if chosen is None:
        example = f"such as {test.cases[0].name}"
        raise UsageError(f"--case {name}: seed {test.seed} has no such case\n  next: name one that it has, {example}")
    with staged_outputs(out, lambda path: force) as staged:
        path = out / write_case_files(chosen, staged).name
    files, published = chosen.lab_files, str(out / SIMULATION_FILE)
    data = {"recording": str(path), "vehicle": str(out / files.vehicle_file), "left_out": list(chosen.left_out)}
    data |= {"simulation": published} if files.simulation else {}
    sink.result(data, lambda: str(path))
    compared = f" --simulation {published}" if files.simulation else ""
    sink.note(f"next: bcid diagnose {path} --vehicle {data['vehicle']}{compared}; the answer is in the same folder")
    if chosen.left_out:
        sink.note(f"the blind test left out {', '.join(chosen.left_out)}; that command does not, and may name them")


def _run_blind_test(
    test: BlindTest, out: Path, workers: Workers, minutes: float | None, sink: Sink, force: bool
) -> None:
    """Diagnose a blind test's simulated takes, which conceal effects; write the scores as prove.json and prove.html."""
    from bcid.cli import show
    from bcid.libraries import require_library
    from bcid.proof.blind.blind_test import run_blind_test
    from bcid.proof.blind.seal import ANSWERS_FILE, SEALS_FILE
    from bcid.report.proof_page import write_proof_page
    from bcid.store.receipt import refuse_to_renew, renew_results

    if test.with_baselines:
        require_library("pysindy", "--baselines, which --quick runs too,")
    refuse_to_renew(out, BLIND_FILES, force)
    if test.salt and not (out / SEALS_FILE).exists():
        refuse_to_renew(out, [ANSWERS_FILE], force)

    def announce_seal(seal: str | None) -> None:
        if seal:
            sink.note(f"seal of {len(test.cases)} answers: {seal}", in_every_format=True)
        else:
            sink.note(
                f"not sealed: anybody can draw the answers from seed {test.seed}; --salt and a secret --seed seal them"
            )
        if not test.quick and minutes is None and len(test.cases) > LIMITS.max_quiet_takes:
            sink.note(f"{len(test.cases)} takes need some hours; a second run continues, and --minutes limits this one")

    with sink.stage("prove") as progress:
        document = run_blind_test(
            test, out, workers, minutes, announce_seal,
            lambda done: progress(done / len(test.cases), f"{done} of {len(test.cases)}"),
        )  # fmt: skip
    renew_results(
        out, dict(zip(BLIND_FILES, (document.write, partial(write_proof_page, document)), strict=True)), force
    )
    sink.result(document.as_json(), lambda: show.proof_tables(document))
    sink.note(f"page: {out / 'prove.html'}")
    if document.missed:
        missed = "; ".join(document.missed)
        raise GoalMissed(f"goals missed ({missed})\n  next: see the wrong answers in {out / 'prove.html'}")


def _vary_limits(
    seed: int, takes: int | None, out: Path, workers: int, minutes: float | None, sink: Sink, force: bool
) -> None:
    """Halve and double each limit that decides, over a panel of simulated takes; tell which verdicts change.

    The panel is drawn from `seed`; it has all its takes where `takes` is None.  The counts are written as limits.json
    into `out`.
    """
    from bcid.cli import show
    from bcid.proof.blind.blind_test import BlindTest
    from bcid.proof.blind.limit_panel import draw_panel
    from bcid.proof.blind.vary_limits import vary_limits
    from bcid.store.receipt import refuse_to_renew, renew_results

    refuse_to_renew(out, [LIMITS_FILE], force)
    panel = draw_panel(BlindTest(seed).cases, seed, takes)
    with sink.stage("prove that no verdict hangs on a limit") as progress:
        document = vary_limits(
            panel, seed, out, workers, minutes,
            lambda done: progress(done / len(panel), f"{done} of {len(panel)}"),
        )  # fmt: skip
    renew_results(out, {LIMITS_FILE: document.write}, force)
    sink.result(document.as_json(), lambda: show.varied_limits_tables(document))
    if document.missed:
        raise GoalMissed(f"goals missed ({'; '.join(document.missed)})\n  next: see the changes in {out / LIMITS_FILE}")


def _ask_real_questions(
    files: Sequence[Path], recordings: Path, only: Sequence[str], out: Path, workers: int, sink: Sink, force: bool
) -> None:
    """Diagnose real recordings whose missing effect is known: withheld from the model, or added by editing the data.

    The questions stand in TOML `files`; with `only`, those alone are asked whose label holds one of its texts.  The
    scored answers and their figures are written as real.json into `out`, and printed.
    """
    from bcid.cli import show
    from bcid.proof.real.figures import real_document
    from bcid.proof.real.jobs import question_code_digest
    from bcid.proof.real.run_questions import run_real_questions
    from bcid.store.receipt import refuse_to_renew, renew_results

    refuse_to_renew(out, [REAL_FILE], force)
    with sink.stage("prove on real recordings") as progress:
        rows = run_real_questions(
            files, recordings, out, workers, only, lambda label, share: progress(share, label)
        )  # fmt: skip
    document = real_document(rows, question_code_digest())
    renew_results(out, {REAL_FILE: document.write}, force)
    sink.result(document.as_json(), lambda: show.real_proof_tables(document))
    if document.missed:
        missed = "; ".join(document.missed)
        raise GoalMissed(f"goals missed ({missed})\n  next: see the answers in {out / REAL_FILE}")

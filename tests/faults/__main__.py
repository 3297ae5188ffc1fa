"""`make fuzz N=10000`, `make kills N=200`: the counts behind what the docs say of faults, and their JSON."""

from __future__ import annotations

import json
import os
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from faults.fuzzing import FAILURES, fuzz

CORES = os.cpu_count() or 1
TAIL = 1500  # characters of a traceback that are shown


def _fuzzed(n: int, workers: int, only: str | None) -> tuple[dict[str, Any], bool]:
    counts: dict[str, Counter[str]] = {}
    peaks: dict[str, float] = {}
    failures: list[dict[str, Any]] = []
    for kind, batch, failed, peak in fuzz(n, workers, only):
        counts.setdefault(kind, Counter()).update(batch)
        peaks[kind] = max(peak, peaks.get(kind, 0.0))
        failures += failed
        typer.echo(f"{kind}: {sum(counts[kind].values())} of {n}", err=True)
    for kind, c in counts.items():
        bad = ", ".join(f"{c[f]} {f}" for f in FAILURES if c[f]) or "no failure"
        rest = ", ".join(f"{v} {k}" for k, v in c.most_common() if k not in FAILURES)
        typer.echo(f"{kind:20} {bad}; {rest}; peak {peaks[kind]:.0f} MiB")
    for failure in failures[:20]:
        typer.echo(json.dumps({k: v for k, v in failure.items() if k != "text"}))
        typer.echo(failure["text"][-TAIL:])
    return {"kinds": {k: {**c, "peak_mib": round(peaks[k])} for k, c in counts.items()}}, bool(failures)


Out = Annotated[Path | None, typer.Option(help="A JSON file whose entry of this name is replaced.")]
Workers = Annotated[int, typer.Option(help="Processes.")]
app = typer.Typer(add_completion=False)


@app.callback()
def options() -> None:
    """Faults on purpose, and what came of them."""


def _keep(out: Path | None, name: str, found: dict[str, Any]) -> None:
    if out is not None:
        known = json.loads(out.read_text()) if out.exists() else {}
        out.write_text(json.dumps({**known, name: found}, indent=1) + "\n")


@app.command(name="fuzz")
def fuzz_(
    n: Annotated[int, typer.Option(help="Mutants of every kind of file.")] = 1000,
    only: Annotated[str | None, typer.Option(help="Kinds whose name holds this.")] = None,
    workers: Workers = CORES,
    out: Out = None,
) -> None:
    """Mutants of every kind of file: tracebacks, hangs, wrong values and silent losses are counted."""
    found, failed = _fuzzed(n, workers, only)
    if only is not None and out is not None and out.exists():  # the others stand
        found["kinds"] = json.loads(out.read_text())["fuzz"]["kinds"] | found["kinds"]
    _keep(out, "fuzz", found)
    raise typer.Exit(1 if failed else 0)


@app.command()
def battery(
    n: Annotated[int, typer.Option(help="Edits of every kind of what is saved.")] = 100,
    only: Annotated[str | None, typer.Option(help="Kinds whose name holds this.")] = None,
    out: Out = None,
) -> None:
    """Edits of every field of everything that is saved, digests made right, loaded and driven in a watched process."""
    from faults import battery as edited

    outcomes = []
    for outcome in edited.run_battery(n, only):
        outcomes.append(outcome)
        if outcome.what in edited.FAILURES:
            typer.echo(json.dumps(outcome._replace(text=outcome.text[-TAIL:])._asdict()))
    counts = edited.count(outcomes)
    for kind, found in counts.items():
        typer.echo(f"{kind:45} {', '.join(f'{v} {k}' for k, v in found.items())}")
    failed = sum(o.what in edited.FAILURES for o in outcomes)
    _keep(out, "battery", {"edits": len(outcomes), "failures": failed, "kinds": counts})
    raise typer.Exit(1 if failed else 0)


@app.command()
def kills(n: Annotated[int, typer.Option(help="Kills.")] = 20, workers: Workers = CORES, out: Out = None) -> None:
    """A pipeline killed at random moments; the next run must end with the bytes of an undisturbed one."""
    from faults.killing import killed

    found, failed = killed(n, workers, partial(typer.echo, err=True))
    typer.echo(json.dumps(found, indent=1))
    _keep(out, "kills", found)
    raise typer.Exit(1 if failed else 0)


@app.command()
def counts(
    recordings: Annotated[Path | None, typer.Option(help="The folder of real recordings, for conformance.")] = None,
    n: Annotated[int, typer.Option(help="Bits to flip in each kind of artifact.")] = 300,
    out: Out = None,
) -> None:
    """The conformance suite, flipped bits in artifacts, files that expand."""
    from faults.counting import bombs, conformance, flipped

    found: dict[str, dict[str, Any]] = {"bombs": bombs(), "flips": flipped(n)}
    failed = not all(b["refused"] for b in found["bombs"].values()) or set(found["flips"]["noticed"].values()) != {n}
    if recordings is not None:
        found["conformance"] = conformance(recordings / "mcap" / "conformance")
        failed |= found["conformance"]["as_described"] != found["conformance"]["files"]
    for name, each in found.items():
        typer.echo(f"{name}: {json.dumps(each)}")
        _keep(out, name, each)
    raise typer.Exit(1 if failed else 0)


if __name__ == "__main__":
    app()

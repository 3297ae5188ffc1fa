"""The tables of the docs that are made of the committed JSON of blind tests, real recordings and timings.

`python tests/docs_tables.py` renews the table of docs/speed.md.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bcid.cli.show import goal_of_timing
from bcid.documents.prove import MethodScores, ProveDocument
from bcid.proof.real.figures import describe_figure, real_figures, with_goals
from bcid.report.proof_page import (
    METHOD_FIGURES,
    SHOWN_IF_ANY,
    count_takes,
    filled_columns,
    format_cell,
    method_figure,
    tier_figures,
    tier_title,
    tiers_not_run,
)
from bcid.report.real_answers import answer_text, misfit_text, question_text, ratio_text, worth_text

BENCH_MARK = "<!-- bench: docs/results/bench.json -->"
"""After it the table of timings begins."""

ALWAYS_SHOWN = ("channel", "not_seen", "coverage")
"""Fields that the table shows for every tier that has them."""


def evidence_table(outcome: ProveDocument) -> str:
    """The table of a run: one row for each tier, goals in brackets."""
    rows = []
    for tier in outcome.tiers:
        wrongly = "wrong" if tier.false is None else "false"
        fields = ("right", "top1", "exact", wrongly, "seconds")
        more = {
            t: f
            for t, f in filled_columns([tier]).items()
            if f not in fields and f in (*tier.goal, *ALWAYS_SHOWN, *SHOWN_IF_ANY)
        }
        right, first, exactly, wrong, seconds = (format_cell(tier, field) for field in fields)
        rest = tier_figures(tier, more, "**{}** missed") or "–"
        rows.append(
            [tier_title(tier.tier), count_takes(outcome, tier.tier), right, first, exactly, wrong, rest, seconds]
        )
    rows += [[tier_title(tier), count_takes(outcome, tier), "not run", *5 * ["–"]] for tier in tiers_not_run(outcome)]
    return _markdown_table(
        ["concealed", "takes", "right", "named first", "just that", "a wrong name", "further", "seconds"], rows
    )


def methods_table(outcome: ProveDocument) -> str:
    """The table of the diagnosis beside other methods on the same takes."""
    return _markdown_table(
        ["method", "n", "figures"],
        [[b.method, str(b.n), _method_summary(b)] for b in outcome.baselines],
    )


def _method_summary(method: MethodScores) -> str:
    """All figures of a method in one line, and its seconds."""
    figures = [f"{title} {method_figure(method, f)}" for title, f in METHOD_FIGURES.items() if getattr(method, f)]
    return "; ".join([*figures, f"seconds {method_figure(method, 'seconds')}"])


def real_figures_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The docs' table of figures of scored rows in documents `bcid.prove-real/2`, pooled, beside their goals."""
    return _markdown_table(
        ["figure", "of how many, 95 % interval, goal"],
        [
            [f.figure, describe_figure(f) + (" **missed**" if f.missed else "")]
            for f in with_goals(real_figures(rows))
        ],
    )  # fmt: skip


def real_answers_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The docs' table of scored rows in documents `bcid.prove-real/2`; variations stand with the question they vary."""
    return _markdown_table(
        ["tier", "recording", "what", "worth (nats)", "error", "misfit", "answered", "or", "right", "varies"],
        [
            [
                row["tier"], " → ".join(_shorten_name(Path(name).stem) for name in row["recording"].split(" → ")),
                question_text(row), worth_text(row), ratio_text(row), misfit_text(row), answer_text(row),
                ", ".join(f"`{name}`" for name in row.get("equivalents", ())) or "–",
                "yes" if row["right"] else "**no**", ", ".join(row.get("changes_with", ())) or "–",
            ]
            for row in rows
            if "variation" not in row
        ],
    )  # fmt: skip


def held_out_table(drives: Mapping[str, Mapping[str, Any]]) -> str:
    """The docs' table of docs/results/real_held_out.json: errors on blocks held out, by drive and horizon.

    Each cell holds 10^3 times the error of the base model, with the names, and with free functions, where they change.
    """
    rows = list[list[str]]()
    for name, drive in drives.items():
        cells = [_shorten_name(Path(name).stem), ", ".join(drive["names"]) or "–", f"{drive['function_share']:g}"]
        for horizon in ("0.5", "2", "10"):
            e = drive["errors"][horizon]
            stages = [e["before"], *([e["after"]] if drive["names"] else []), e["remainder"]]
            errors = [1e3 * error for error in stages if error is not None]
            cells.append(" → ".join(f"{error:.3g}" if error < 999.5 else f"{error:.0f}" for error in errors))
        rows.append(cells)
    return _markdown_table(["drive", "names", "share of the functions", "0.5 s", "2 s", "10 s"], rows)


LARGE_FILES = {
    "motive": "Motive CSV, {:.2g} GB", "mcap": "MCAP, {:.2g} GB: poses in CDR, commands, a camera",
    "mcap-json": "MCAP, {:.2g} GB: poses in JSON, commands, a camera",
}  # fmt: skip
"""What kinds of large recordings hold, with their size."""


def memory_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The docs' table of docs/results/memory.json: the largest resident memory of commands on large recordings."""
    return _markdown_table(
        ["file", "of which the car", "command", "memory", "time"],
        [
            [
                LARGE_FILES[row["kind"]].format(row["gigabytes"]),
                f"{row['hours']:g} h at 240 Hz ({row['poses'] / 1e6:.2f} million poses)", f"`bcid {row['command']}`",
                f"{row['peak_mib']} MiB", f"{row['seconds']} s",
            ]
            for row in rows if row["exit"] == 0
        ],
    )  # fmt: skip


def pushes_table(laws: Sequence[Mapping[str, Any]]) -> str:
    """The docs' table of docs/results/pushes.json: what each law of the pushes leaves to functions without a name.

    Each cell holds the nats that they explain beside a base model, by chance, and those of the base model beyond that
    with the first law.
    """
    head = [f"{1.5 / law['knots']:g} s, {'lasting' if law['lasting'] else 'independent'}" for law in laws]
    rows = list[list[str]]()
    for name, first in laws[0]["takes"].items():
        cells = list[str]()
        for take in (law["takes"][name] for law in laws):
            more = take["log_likelihood"] - first["log_likelihood"]
            cells.append(f"{take['explained']:.0f}, {take['by_chance']:.0f}" + (f" (+{more:.0f})" if more else ""))
        rows.append([_shorten_name(name), *cells])
    return _markdown_table(["take", *head], rows)


def _shorten_name(name: str, most: int = 32) -> str:
    """The last words of a name that has more than `most` characters.

    >>> _shorten_name("car_1_Datarecording_09_16_2024_10_01_01"), _shorten_name("lap_3")
    ('…09_16_2024_10_01_01', 'lap_3')
    """
    words = name.split("_")
    while len("_".join(words)) > most and len(words) > 1:
        words.pop(0)
    short = "_".join(words)
    return short if short == name else f"…{short}"


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table of text cells."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


def bench_table(bench: Mapping[str, Any]) -> str:
    """Every timing beside its peer's, with goal and difference."""
    rows = [
        "| path | ours (ms) | peer | peer (ms) | ratio | goal | results differ by |", "|---|---|---|---|---|---|---|"
    ]  # fmt: skip
    for r in bench["rows"]:
        goal = goal_of_timing(r).replace("missed", "**missed**")
        apart = "–" if r["difference"] is None else f"{r['difference']:.1g}"
        cells = [r["path"], f"{r['ours_ms']:.3g}", r["peer"], f"{r['peer_ms']:.4g}", f"{r['ratio']:.3g} ×", goal, apart]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def renew_bench_table(text: str, bench: Mapping[str, Any]) -> str:
    """The text of docs/speed.md with the table of these timings in the place of the one that is there."""
    before, mark, rest = text.partition(BENCH_MARK)
    after = rest.lstrip("\n").split("\n")
    below = next((i for i, line in enumerate(after) if not line.startswith("|")), len(after))
    return "\n".join([before + mark, bench_table(bench), *after[below:]])


if __name__ == "__main__":
    docs = Path(__file__).parent.parent / "docs"
    timings = json.loads((docs / "results" / "bench.json").read_text(encoding="utf-8"))
    speed = docs / "speed.md"
    speed.write_text(renew_bench_table(speed.read_text(encoding="utf-8"), timings), encoding="utf-8")

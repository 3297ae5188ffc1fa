"""The tables of the docs that are made of the committed JSON of blind tests and real recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bcid.documents.prove import MethodScores, ProveDocument
from bcid.proof.real.questions import NOT_ASKED
from bcid.report.proof_page import (
    METHOD_FIGURES,
    SHOWN_IF_ANY,
    count_takes,
    error_ratio_text,
    filled_columns,
    format_cell,
    method_figure,
    tier_figures,
    tier_title,
    tiers_not_run,
)

ALWAYS_SHOWN = ("channel", "not_seen", "coverage")
"""Fields that the README's table shows for every tier that has them."""


def evidence_table(outcome: ProveDocument) -> str:
    """The README's table of a run: one row for each tier, goals in brackets."""
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
    """The README's table of the diagnosis beside other methods on the same takes."""
    return _markdown_table(
        ["method", "n", "figures"],
        [[b.method, str(b.n), _method_summary(b)] for b in outcome.baselines],
    )


def _method_summary(method: MethodScores) -> str:
    """All figures of a method in one line, and its seconds."""
    figures = [f"{title} {method_figure(method, f)}" for title, f in METHOD_FIGURES.items() if getattr(method, f)]
    return "; ".join([*figures, f"seconds {method_figure(method, 'seconds')}"])


def answers_table(outcomes: Sequence[Mapping[str, Any]]) -> str:
    """The docs' table of questions to real recordings: one row for each, sorted by tier."""
    rows = [row for outcome in outcomes for row in outcome["rows"]]
    tiers = list(dict.fromkeys(row["tier"] for row in rows))
    rows.sort(key=lambda r: (tiers.index(r["tier"]), r["recording"], r["case"]))
    return _markdown_table(
        ["tier", "recording", "what", "error", "answered", "right"],
        [
            [
                row["tier"], _shorten_name(Path(row["recording"]).stem), question_text(row),
                error_ratio_text(row, "× {:.2f}"), _answer_text(row),
                "–" if row["verdict"] == NOT_ASKED else "yes" if row["right"] else "**no**",
            ]
            for row in rows
        ],
    )  # fmt: skip


def question_text(row: Mapping[str, Any]) -> str:
    """What was asked of a real recording; of an edit also what the unedited drive showed of it.

    >>> question_text({"case": "motor lag"})
    'motor lag'
    >>> question_text({"case": "pose_latency 0.05", "before": {"tau": [-0.0102, 0.001]}})
    'pose_latency 0.05, before: -0.0102'
    """
    if row.get("before") is None:
        return str(row["case"])
    before = row["before"] if isinstance(row["before"], float) else next(iter(row["before"].values()))[0]
    return f"{row['case']}, before: {before:.3g}"


def _answer_text(row: Mapping[str, Any]) -> str:
    """The effects named with their twins and values, published values beside them; or the verdict.

    >>> zone = {"effect": "motor_dead_zone", "twins": [], "values": {"width": [0.162, 0.002]}}
    >>> _answer_text({"findings": [zone], "published": {"motor_dead_zone__width": 0.164}})
    '`motor_dead_zone` (0.162 ± 0.002; published 0.164)'
    """
    names_and_values = []
    for finding in row["findings"]:
        published = {s: row.get("published", {}).get(f"{finding['effect']}__{s}") for s in finding["values"]}
        values = ", ".join(
            f"{v:.3g} ± {se:.1g}" + (f"; published {published[s]:.3g}" if published[s] is not None else "")
            for s, (v, se) in finding["values"].items()
        )
        names = " or ".join(f"`{name}`" for name in (finding["effect"], *finding["twins"]))
        names_and_values.append(f"{names} ({values})")
    if names_and_values:
        return "; ".join(names_and_values)
    where = f" in {row['remainder']['channel']}" if row["verdict"] == "unknown" else ""
    return f"{row['verdict']}{where}"


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

"""The page of a blind test and its table for the README, from its JSON alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bcid.report.proof_figures import calibration_picture, confusion_picture
from bcid.report.templates import template

COLUMNS = {
    "right": "right", "first": "top1", "in the set": "set", "exact": "exact", "false alarms": "false",
    "unknown": "unknown", "wrong name": "wrong", "in its channel": "channel", "told as not excited": "not_seen",
    "measurement so called": "kind", "located": "located", "place": "place_overlap", "time": "time_overlap",
    "set size": "set_size", "parameter error": "parameter_error", "95 % intervals hold": "coverage",
    "oracle's gain": "oracle_share", "not shown": "unshown", "shown, told as not excited": "denied",
    "more told beside": "more",
    "errors": "errors", "seconds": "seconds",
}  # fmt: skip
PLAIN = ("set_size", "seconds", "place_overlap", "time_overlap", "errors")
"""Fields that are no shares of takes."""

UNUSUAL = ("errors", "unshown")
"""Fields that are told where there is something to tell."""

ALWAYS = ("channel", "not_seen", "coverage")
"""Fields that the README's table has of every tier that fills them."""

TITLES = {
    "null": "nothing", "null-imperfect": "nothing, imperfect base", "single": "one effect",
    "single-imperfect": "one effect, imperfect base", "half-size": "one effect of half the size",
    "double-size": "one effect of twice the size", "pair": "two effects", "triple": "three effects",
    "measurement-and-vehicle": "an effect of the measurement and one of the vehicle",
    "left-out": "one effect that may not be named", "outside": "an effect outside the vocabulary",
    "unexcited": "an effect that the drive does not excite", "closed-loop": "one effect, a driver who follows a path",
    "two-minutes": "one effect, two minutes", "thirty-minutes": "one effect, thirty minutes",
    "ten-hertz": "one effect, poses at 10 Hz", "hundred-twenty-hertz": "one effect, poses at 120 Hz",
    "three-times-noise": "one effect, three times the noise",
}  # fmt: skip
"""What is concealed in the takes of a tier: of ten minutes at 60 Hz, where it says nothing else."""

SAID = {
    "first": "top1", "detects": "detected", "false alarms": "false", "of the error explained": "explained",
    "failed": "failed",
}  # fmt: skip
"""What is told of each method on the same takes."""

NOT_ASKED = "not asked"
"""Of a real recording: what makes no difference where it is withheld."""


def cell(tier: Mapping[str, Any], field: str, marked: str = "**{}** missed") -> str:
    """A figure with its goal in brackets; marked where the goal is missed."""
    value: float | None = tier.get(field)
    goal: Sequence[float] | None = tier["goal"].get(field)
    if value is None:
        return "–"  # nothing in the tier asks for it
    text = _number(value, field)
    if tier.get(f"{field}_ci95"):
        text += " [{:.3g} to {:.3g}]".format(*(100.0 * end for end in tier[f"{field}_ci95"]))
    if field in tier["missed"]:
        text = marked.format(text)
    return f"{text} ({_goal(goal[0], goal[1], field)})" if goal else text


def _number(value: float, field: str) -> str:
    if field in PLAIN:
        return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"
    return f"{100.0 * value:.3g}\N{NO-BREAK SPACE}%"


def _goal(low: float, high: float, field: str) -> str:
    if low > 0.0 and high < 1.0:
        return f"{_number(low, field)} to {_number(high, field)}"
    return f"≥\N{NO-BREAK SPACE}{_number(low, field)}" if low > 0.0 else f"≤\N{NO-BREAK SPACE}{_number(high, field)}"


def shown(tiers: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The columns that any of the tiers fills."""
    return {
        title: f
        for title, f in COLUMNS.items()
        if any(t.get(f) is not None and (f not in UNUSUAL or t[f] > 0) for t in tiers)
    }


def figures(tier: Mapping[str, Any], columns: Mapping[str, str], marked: str) -> str:
    """All that a tier has of `columns`, in one line; those that miss their goals `marked`."""
    told = {title: cell(tier, field, marked) for title, field in columns.items()}
    return "; ".join(f"{title} {text}" for title, text in told.items() if text != "–")


def again(outcome: Mapping[str, Any]) -> str:
    """The options that make the same cases.

    >>> again({"seed": 7, "sizes": {"repeats": 3, "nulls": 20, "every": 2}}), again({"seed": 1})
    ('--seed 7 --repeats 3 --nulls 20', '--seed 1')
    """
    sizes = {name.replace("_", "-"): n for name, n in outcome.get("sizes", {}).items() if name != "every"}
    return " ".join([f"--seed {outcome['seed']}", *(f"--{name} {n}" for name, n in sizes.items())])


def takes(outcome: Mapping[str, Any], tier: str) -> str:
    """How many takes of a tier were run, of how many if not all.

    >>> run = {"tiers": [{"tier": "null", "n": 3}], "tiers_of": {"null": 5, "pair": 2}}
    >>> takes(run, "null"), takes(run, "pair"), takes({"tiers": run["tiers"]}, "null")
    ('3 of 5', '0 of 2', '3')
    """
    n = next((t["n"] for t in outcome["tiers"] if t["tier"] == tier), 0)
    whole = outcome.get("tiers_of", {}).get(tier, n)
    return str(n) if n == whole else f"{n} of {whole}"


def not_run(outcome: Mapping[str, Any]) -> list[str]:
    """Tiers that a part of a run has no take of."""
    return [tier for tier in outcome.get("tiers_of", {}) if tier not in {t["tier"] for t in outcome["tiers"]}]


def evidence(outcome: Mapping[str, Any]) -> str:
    """The README's table of a run: one row a tier, goals in brackets."""
    rows = []
    for tier in outcome["tiers"]:
        wrongly = "wrong" if tier["false"] is None else "false"
        told = ("right", "top1", "exact", wrongly, "seconds")
        more = {t: f for t, f in shown([tier]).items() if f not in told and f in (*tier["goal"], *ALWAYS, *UNUSUAL)}
        right, first, exactly, wrong, seconds = (cell(tier, field) for field in told)
        rest = figures(tier, more, "**{}** missed") or "–"
        rows.append([_title(tier["tier"]), takes(outcome, tier["tier"]), right, first, exactly, wrong, rest, seconds])
    rows += [[_title(tier), takes(outcome, tier), "not run", *5 * ["–"]] for tier in not_run(outcome)]
    return _markdown(
        ["concealed", "takes", "right", "named first", "just that", "a wrong name", "further", "seconds"], rows
    )


def _title(tier: str) -> str:
    return TITLES.get(tier, tier)


def methods(outcome: Mapping[str, Any]) -> str:
    """The README's table of the diagnosis beside other methods on the same takes."""
    return _markdown(
        ["method", "n", "figures"],
        [[b["method"], str(b["n"]), _of_a_method(b)] for b in outcome.get("baselines") or []],
    )


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


def _shortened(name: str, most: int = 32) -> str:
    """The last words of a long name.

    >>> _shortened("car_1_Datarecording_09_16_2024_10_01_01"), _shortened("lap_3")
    ('…09_16_2024_10_01_01', 'lap_3')
    """
    words = name.split("_")
    while len("_".join(words)) > most and len(words) > 1:
        words.pop(0)
    short = "_".join(words)
    return short if short == name else f"…{short}"


def answers(outcomes: Sequence[Mapping[str, Any]]) -> str:
    """The docs' table of questions to real recordings: one row each, a tier's together."""
    rows = [row for outcome in outcomes for row in outcome["rows"]]
    tiers = list(dict.fromkeys(row["tier"] for row in rows))
    rows.sort(key=lambda r: (tiers.index(r["tier"]), r["recording"], r["case"]))
    return _markdown(
        ["tier", "recording", "what", "error", "answered", "right"],
        [
            [
                row["tier"], _shortened(Path(row["recording"]).stem), asked(row),
                raised(row, "× {:.2f}"), _answered(row),
                "–" if row["verdict"] == NOT_ASKED else "yes" if row["right"] else "**no**",
            ]
            for row in rows
        ],
    )  # fmt: skip


def asked(row: Mapping[str, Any]) -> str:
    """What was asked; of an edit also what the drive showed of it before.

    >>> asked({"case": "motor lag"}), asked({"case": "pose_latency 0.05", "before": {"tau": [-0.0102, 0.001]}})
    ('motor lag', 'pose_latency 0.05, before: -0.0102')
    """
    if row.get("before") is None:
        return str(row["case"])
    before = row["before"] if isinstance(row["before"], float) else next(iter(row["before"].values()))[0]
    return f"{row['case']}, before: {before:.3g}"


def raised(row: Mapping[str, Any], form: str) -> str:
    """How much an error is raised by what is withheld; a simulation may leave the numbers without it.

    >>> raised({"ratio": 1.967}, "× {:.2f}"), raised({"ratio": None}, "{}"), raised({}, "{}")
    ('× 1.97', 'endless', '–')
    """
    if "ratio" not in row:
        return "–"
    return "endless" if row["ratio"] is None else form.format(row["ratio"])


def _answered(row: Mapping[str, Any]) -> str:
    """Names with their twins and values, published ones beside them, or the verdict.

    >>> zone = {"effect": "motor_dead_zone", "twins": [], "values": {"width": [0.162, 0.002]}}
    >>> _answered({"findings": [zone], "published": {"motor_dead_zone__width": 0.164}})
    '`motor_dead_zone` (0.162 ± 0.002; published 0.164)'
    """
    told = []
    for finding in row["findings"]:
        published = {s: row.get("published", {}).get(f"{finding['effect']}__{s}") for s in finding["values"]}
        values = ", ".join(
            f"{v:.3g} ± {se:.1g}" + (f"; published {published[s]:.3g}" if published[s] is not None else "")
            for s, (v, se) in finding["values"].items()
        )
        names = " or ".join(f"`{name}`" for name in (finding["effect"], *finding["twins"]))
        told.append(f"{names} ({values})")
    if told:
        return "; ".join(told)
    where = f" in {row['remainder']['channel']}" if row["verdict"] == "unknown" else ""
    return f"{row['verdict']}{where}"


def _of_a_method(method: Mapping[str, Any]) -> str:
    """What a method that may not name anything has to show."""
    told = [f"{title} {said_by(method, f)}" for title, f in SAID.items() if method[f]]
    return "; ".join([*told, f"seconds {said_by(method, 'seconds')}"])


def said_by(method: Mapping[str, Any], field: str) -> str:
    """A figure of a method: of how many takes, a share, or a number.

    >>> net = {"top1": None, "detected": [12, 13], "explained": 0.717, "failed": 0}
    >>> [said_by(net, field).replace("\N{NO-BREAK SPACE}", " ") for field in net]
    ['–', '12 of 13', '71.7 %', '0']
    """
    value = method[field]
    if value is None:
        return "–"  # such a method fits, and cannot name
    if isinstance(value, Sequence):
        return f"{value[0]} of {value[1]}"
    return _number(value, field) if isinstance(value, float) else str(value)


def write_proof_page(outcome: Mapping[str, Any], path: Path) -> None:
    """Write the page of `outcome` to `path`: offline, no script, everything escaped."""
    columns = shown(outcome["tiers"])
    rows = [
        {
            "tier": _title(t["tier"]),
            "n": takes(outcome, t["tier"]),
            "cells": [(cell(t, f, "{} missed"), f in t["missed"]) for f in columns.values()],
        }
        for t in outcome["tiers"]
    ]
    text = template("proof.html.j2").render(
        o=outcome, again=again(outcome), columns=list(columns), rows=rows, not_run=list(map(_title, not_run(outcome))),
        whole=outcome.get("of", outcome["cases"]), known_before=outcome.get("known_before", 0),
        made_after_opening=outcome.get("made_after_opening", 0), missed=outcome["missed"],
        said=SAID, said_by=said_by, baselines=outcome.get("baselines") or [],
        confusion=confusion_picture(outcome["confusion"]),
        calibration=calibration_picture(outcome["calibration"]) if outcome["calibration"]["bins"] else None,
    )  # fmt: skip
    path.write_text(text, encoding="utf-8")

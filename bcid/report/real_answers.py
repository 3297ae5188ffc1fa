"""Answers to questions about real recordings in words: what was asked, what it is worth, what was answered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Row = Mapping[str, Any]


def question_text(row: Row) -> str:
    """What was asked of a real recording; of an edit also what the unedited drive showed of it.

    >>> question_text({"case": "motor lag"})
    'motor lag'
    >>> question_text({"case": "pose_latency 0.05", "before": {"tau": [-0.0102, 0.001]}})
    'pose_latency 0.05, before: -0.0102'
    >>> question_text({"case": "motor lag", "variation": "motor / 1.3"})
    'motor lag, motor / 1.3'
    """
    variation = f", {row['variation']}" if "variation" in row else ""
    if row.get("before") is None:
        return f"{row['case']}{variation}"
    before = row["before"] if isinstance(row["before"], float) else next(iter(row["before"].values()))[0]
    return f"{row['case']}, before: {before:.3g}{variation}"


def worth_text(row: Row) -> str:
    """What is withheld, or edited, is worth, beside the gate, in nats; a dash where it was not weighed.

    >>> worth_text({"worth": 545.3, "gate": 14.2}), worth_text({})
    ('545 (gate 14)', '–')
    """
    return f"{row['worth']:.0f} (gate {row['gate']:.0f})" if "worth" in row else "–"


def ratio_text(row: Row) -> str:
    """By what factor an error grows without what is withheld; "endless" where a prediction diverges.

    >>> [ratio_text(row) for row in ({"ratio": 1.967}, {"ratio": None}, {})]
    ['× 1.97', 'endless', '–']
    """
    if "ratio" not in row:
        return "–"
    return "endless" if row["ratio"] is None else f"× {row['ratio']:.2f}"


def misfit_text(row: Row) -> str:
    """How far the simulation with nothing withheld is off: RMSE of speed and yaw rate, nats a segment when refitted.

    >>> misfit_text({"misfit": {"rmse": {"v_x": 0.0961, "yaw_rate": 0.159}, "nats": -3.2}})
    '0.096 m/s, 0.159 rad/s, -3.2'
    >>> misfit_text({})
    '–'
    """
    if not row.get("misfit"):
        return "–"
    rmse, nats = row["misfit"]["rmse"], row["misfit"]["nats"]
    speed, yaw_rate = ("endless" if v is None else f"{v:.3f}" for v in (rmse["v_x"], rmse["yaw_rate"]))
    return f"{speed} m/s, {yaw_rate} rad/s, {nats:.1f}"


def answer_text(row: Row, mark: str = "`") -> str:
    """The answer in a row: effects with twins and values, published values beside them; sizes; errors; or the verdict.

    Names stand between `mark`s.

    >>> zone = {"effect": "motor_dead_zone", "twins": [], "values": {"width": [0.162, 0.002]}}
    >>> answer_text({"findings": [zone], "published": {"motor_dead_zone__width": 0.164}})
    '`motor_dead_zone` (0.162 ± 0.002; published 0.164)'
    >>> answer_text({"verdict": "unknown", "findings": [], "remainder": {"channel": "fy"}})
    'unknown in fy'
    """
    if row.get("error"):
        return f"failed: {row['error']}"
    if "errors" in row:
        return _errors_text(row)
    if "sizes" in row:
        return _replication_text(row, mark)
    names_and_values = [_finding_text(finding, row.get("published", {}), mark) for finding in row["findings"]]
    if names_and_values:
        return "; ".join(names_and_values)
    where = f" in {row['remainder']['channel']}" if row["verdict"] == "unknown" else ""
    return f"{row['verdict']}{where}"


def _finding_text(finding: Row, published: Mapping[str, float], mark: str) -> str:
    """One finding: its name and what cannot be told from it, its values and what is published of them."""
    own = {s: published.get(f"{finding['effect']}__{s}") for s in finding["values"]}
    values = ", ".join(
        f"{v:.3g} ± {se:.1g}" + (f"; published {own[s]:.3g}" if own[s] is not None else "")
        for s, (v, se) in finding["values"].items()
    )
    names = " or ".join(f"{mark}{name}{mark}" for name in (finding["effect"], *finding["twins"]))
    return f"{names} ({values})"


def _errors_text(row: Row) -> str:
    """Median errors of all methods on another drive, smallest first.

    >>> _errors_text({"errors": {"base": {"median_m": 0.21}, "k-sindy": {"median_m": None}}})
    'base 0.21 m; k-sindy lost'
    """
    medians = {name: e["median_m"] for name, e in row["errors"].items()}
    best_first = sorted(medians, key=lambda name: (medians[name] is None, medians[name] or 0.0))
    return "; ".join(f"{n} lost" if medians[n] is None else f"{n} {medians[n]:.3g} m" for n in best_first)


def _replication_text(row: Row, mark: str) -> str:
    """What two drives show: the sizes of what both name, and what only one of them does."""
    sizes = [
        f"{mark}{s['effect']}{mark} {s['first'][0]:.3g} ± {s['first'][1]:.1g}, "
        f"{s['second'][0]:.3g} ± {s['second'][1]:.1g}"
        + ("" if s["same"] else " (told as changed)" if s["effect"] in row["changed"] else " (**differs**)")
        for s in row["sizes"]
    ]  # fmt: skip
    only = [
        f"only the {which}: {', '.join(f'{mark}{name}{mark}' for name in names)}"
        for which, names in row["only"].items()
        if names
    ]
    return "; ".join([*sizes, *only]) or "nothing on either"

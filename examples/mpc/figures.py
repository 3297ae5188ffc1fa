"""Figures of many drives: shares and medians with intervals; their JSON, merged of parts, and its picture."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

SCHEMA = "bcid.mpc/1"
RESAMPLES = 4000


def share_interval(successes: int, count: int) -> tuple[float, float]:
    """The 95 % Wilson interval of a share, of so many `successes` among `count`."""
    from scipy.stats import binomtest

    interval = binomtest(successes, count).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def median_interval(values: Sequence[float]) -> dict[str, float] | None:
    """The median of `values` and its 95 % bootstrap interval over them; None where there are fewer than two."""
    if len(values) < 2:
        return None
    samples = np.random.default_rng(0).choice(np.asarray(values), (RESAMPLES, len(values)))
    low, high = np.quantile(np.median(samples, axis=1), [0.025, 0.975])
    return {"median": float(np.median(values)), "low": float(low), "high": float(high)}


def summarise(drives: list[dict[str, Any]], concealed: Sequence[str]) -> dict[str, Any]:
    """The whole JSON of all `drives`: a summary for each model, then each drive with its track."""
    summary = {}
    for name in dict.fromkeys(d["model"] for d in drives):
        own = [d for d in drives if d["model"] == name]
        parked = [d for d in own if d["parked"]]
        times = np.concatenate([d["plan_s"] for d in own])
        summary[name] = {
            "drives": len(own), "parked": len(parked), "parked_ci95": share_interval(len(parked), len(own)),
            "time_s": median_interval([d["time_s"] for d in parked]),
            "position_error_m": median_interval([d["position_error_m"] for d in own]),
            "heading_error_deg": median_interval([d["heading_error_deg"] for d in own]),
            "cost_m_s": median_interval([d["cost_m_s"] for d in own]),
            "clearance_m": median_interval([d["clearance_m"] for d in own]),
            "least_clearance_m": min(d["clearance_m"] for d in own),
            "touched": sum(int(d["clearance_m"] < 0.0) for d in own),
            "backward_m": median_interval([d["backward_m"] for d in own]),
            "beyond_90_deg_s": median_interval([d["beyond_90_deg_s"] for d in own]),
            "blind_m": median_interval([d["blind_m"] for d in own]),
            "blind_deg": median_interval([d["blind_deg"] for d in own]),
            "plan_s": {"median": float(np.median(times)), "max": float(times.max())},
        }  # fmt: skip
    told = [d["predictions_m"] for d in drives if "predictions_m" in d]
    predictions = {
        name: {ahead: median_interval([t[name][ahead] for t in told]) for ahead in told[0][name]}
        for name in (told[0] if told else ())
    }
    return {
        "schema": SCHEMA, "concealed": list(concealed), "summary": summary, "predictions_m": predictions,
        "drives": drives,
    }  # fmt: skip


def format_interval(figure: dict[str, float] | None, digits: int, factor: float = 1.0) -> str:
    """A median with its interval as text; a dash where there is none."""
    if figure is None:
        return "–"
    median, low, high = (f"{factor * figure[key]:.{digits}f}" for key in ("median", "low", "high"))
    return f"{median} ({low} – {high})"


def drives_table(found: dict[str, Any]) -> str:
    """The table of drives in docs/mpc.md, in Markdown."""
    rows = [
        "| model | parked | time (s) | off at the end (cm) | off in heading (°) | cost (m s) | closest (cm) | hits |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, s in found["summary"].items():
        low, high = s["parked_ci95"]
        cells = [
            name, f"{s['parked']} of {s['drives']} ({100 * low:.0f} – {100 * high:.0f} %)",
            format_interval(s["time_s"], 1), format_interval(s["position_error_m"], 1, 100.0),
            format_interval(s["heading_error_deg"], 1), format_interval(s["cost_m_s"], 2),
            f"{100 * s['least_clearance_m']:.1f}", str(s["touched"]),
        ]  # fmt: skip
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def predictions_table(found: dict[str, Any]) -> str:
    """The table of prediction errors and solving times in docs/mpc.md, in Markdown."""
    aheads = list(next(iter(found["predictions_m"].values())))
    blind_titles = "whole first plan (cm) | its heading (°)"
    rows = [f"| model | {' | '.join(f'{a} ahead (mm)' for a in aheads)} | {blind_titles} | plan (ms) | slowest (ms) |"]
    rows.append("|" + "---|" * (len(aheads) + 5))
    for name, errors in found["predictions_m"].items():
        s = found["summary"][name]
        blind = [format_interval(s["blind_m"], 1, 100.0), format_interval(s["blind_deg"], 1)]
        solving = [f"{1e3 * s['plan_s'][key]:.0f}" for key in ("median", "max")]
        rows.append(
            f"| {' | '.join([name, *(format_interval(errors[a], 1, 1000.0) for a in aheads), *blind, *solving])} |"
        )
    return "\n".join(rows)


def main() -> None:
    """Merge JSON files of parts of the drives, draw the picture of them, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", type=Path, nargs="+", help="what replay.py has written")
    parser.add_argument("--out", type=Path, help="the JSON of all of them")
    parser.add_argument("--picture", type=Path, help="the PNG to draw")
    asked = parser.parse_args()
    parts = [json.loads(path.read_text(encoding="utf-8")) for path in asked.parts]
    found = summarise([d for part in parts for d in part["drives"]], parts[0]["concealed"])
    if asked.out:
        asked.out.write_text(json.dumps(found, separators=(",", ":")) + "\n", encoding="utf-8")
    if asked.picture:
        from picture import draw_drives

        draw_drives(found, asked.picture)
    sys.stdout.write(f"{drives_table(found)}\n\n{predictions_table(found)}\n")


if __name__ == "__main__":
    main()

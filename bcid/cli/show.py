"""Results as tables for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Group
from rich.table import Table

from bcid.cli.sink import table


def _thousandths(value: float | None) -> str:
    return "diverged" if value is None else (f"{1e3 * value:.2f}" if value < 1 else f"{1e3 * value:.3g}")


def comparison(report: Mapping[str, Any]) -> Table:
    """Models, best first."""
    take = report["validation"]
    rows = [
        [
            m["model"], _thousandths(m["nmse"]),
            "–" if m["nmse_ci95"] is None else " – ".join(_thousandths(v) for v in m["nmse_ci95"]),
            _thousandths(m["nmse_vx"]), _thousandths(m["nmse_vy"]), _thousandths(m["nmse_yaw_rate"]),
            f"{m['rollout_ms']:.3g}", str(m["parameters"]),
        ]
        for m in report["models"]
    ]  # fmt: skip
    title = f"closed loop on {take['name']} ({take['duration_s']:.0f} s), NMSE × 10³"
    return table(title, ["model", "NMSE", "95 % interval", "v_x", "v_y", "yaw rate", "rollout ms", "parameters"], rows)


def recordings(taken: Sequence[Mapping[str, Any]]) -> Group:
    """Ingested recordings and what was odd about them."""
    rows = [
        [r["name"], r["sources"][0]["format"], f"{r['duration_s']:.1f} s", f"{r['rate_hz']:.4g} Hz", _clock(r["clock"])]
        for r in taken
    ]
    odd = [
        [r["name"], i["kind"], i["action"], str(i["count"]), i["where"], i["detail"]]
        for r in taken
        for i in r["irregularities"]
    ]
    tables = [table("recordings", ["take", "format", "length", "poses", "clock offset (95 %)"], rows)]
    if odd:
        tables.append(table("irregularities", ["take", "what", "done", "count", "where", "detail"], odd))
    return Group(*tables)


def _clock(clock: Mapping[str, Any]) -> str:
    if clock.get("offset_s") is None:
        return f"none: {clock.get('reason', 'not estimated')}"
    low, high = clock["offset_ci95"]
    return f"{1e3 * clock['offset_s']:.1f} ms ({1e3 * low:.1f} … {1e3 * high:.1f})"


def estimates(made: Sequence[Mapping[str, Any]]) -> Table:
    """The estimator's consistency."""
    rows = []
    for e in made:
        nis, truth = e["facts"]["nis"], e["facts"].get("truth")
        band = " … ".join(f"{v:.3f}" for v in nis["band95"])
        rmse = "–" if truth is None else ", ".join(f"{v:.3g}" for v in list(truth["rmse"].values())[:3])
        rows.append([e["name"], f"{nis['mean_per_dof']:.3f}", band, rmse, e["folder"]])
    columns = ["take", "NIS per quantity", "95 % band", "RMSE v_x, v_y, yaw rate", "written to"]
    return table("estimates", columns, rows)

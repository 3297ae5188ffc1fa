"""Results as tables for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from bcid.cli.sink import table, thousandths
from bcid.report.estimate_words import lost_car, steering_lines

NIS_RANGE = (0.7, 1.4)  # beyond, the noise model is wrong for the take
NEES = ("nees_filter", "nees_smoother")


def comparison(report: Mapping[str, Any]) -> Table:
    """Models, best first."""
    take = report["validation"]
    rows = [
        [
            m["model"], thousandths(m["nmse"]),
            "–" if m["nmse_ci95"] is None else " – ".join(thousandths(v) for v in m["nmse_ci95"]),
            thousandths(m["nmse_vx"]), thousandths(m["nmse_vy"]), thousandths(m["nmse_yaw_rate"]),
            "–" if m["rollout_ms"] is None else f"{m['rollout_ms']:.3g}", str(m["parameters"]),
        ]
        for m in report["models"]
    ]  # fmt: skip
    weights, machine = report["weights"], report["machine"]
    caption = (
        f"W = diag({weights['v_x']:.3g} s/m, {weights['v_y']:.3g} s/m, {weights['yaw_rate']:.3g} s/rad); "
        f"rollout of the whole take on {machine['processor']}, {machine['cores']} cores"
    )
    title = f"closed loop on {take['name']} ({take['duration_s']:.0f} s), NMSE × 10³"
    columns = ["model", "NMSE", "95 % interval", "v_x", "v_y", "yaw rate", "rollout ms", "parameters"]
    return table(title, columns, rows, caption)


def diagnosis(found: Mapping[str, Any]) -> Group:
    """Verdict, findings, and what they are worth on held-out blocks."""
    from bcid.report.diagnosis_page import number, plain, unit, verdict_sentence, with_error

    parts: list[Any] = [escape(verdict_sentence(found))]
    if found["contacts"]:
        hits = ", ".join(f"{c['kind']} at {c['begin_s']:.1f} s" for c in found["contacts"])
        parts.insert(0, f"excluded: {hits}")
    rows = [
        [
            plain(f["effect"]), f["equation"],
            ", ".join(f"{s} = {with_error(v['value'], v['se'], v['unit'])}" for s, v in f["parameters"].items()),
            f"{f['probability']:.2f}", f"{f['heldout_gain']:.0f}", ", ".join(f["twins"]) or "–",
        ]
        for f in found["findings"]
    ]  # fmt: skip
    if rows:
        columns = ["found", "equation", "fitted", "probability", "held-out gain (nats)", "not told from"]
        parts.append(table("findings", columns, rows))
    judged = [
        [
            f"{h['horizon_s']:g} s",
            *(thousandths(h[k]) for k in ("nmse_before", "nmse_after", "nmse_floor")),
            " – ".join(f"{v:.3g}" for v in h["ratio_ci95"] or ()),
        ]
        for h in found["horizons"]
    ]
    title = "closed loop on held-out blocks, NMSE × 10³"
    lost = ", ".join(f"{100.0 * h['lost']:.2g} % at {h['horizon_s']:g} s" for h in found["horizons"] if h["lost"])
    note = f"left out, where predictions leave the finite numbers: {lost} of the time" if lost else ""
    parts.append(table(title, ["horizon", "before", "after", "noise floor", "after/before (95 %)"], judged, note))
    if found["not_excited"]:
        unseen = ", ".join(
            f"{u['effect']} at any size"
            if (least := u["smallest_detectable"])["value"] is None
            else f"{u['effect']} below {number(least['value'])} {unit(least['unit'])}".rstrip(" –")
            for u in found["not_excited"]
        )
        parts.append(escape(f"could not be seen here: {unseen}"))
    if found["next_manoeuvre"]:
        drive = found["next_manoeuvre"]
        parts.append(escape(f"next: drive {drive['name']} ({drive['file']}): {drive['why']}"))
    return Group(*parts)


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


def estimates(made: Sequence[Mapping[str, Any]]) -> Group:
    """The estimator's constants and consistency, and its error where a truth is known."""
    rows = []
    for e in made:
        facts, nis = e["facts"], e["facts"]["nis"]
        told = dict(steering_lines(facts))
        band = " … ".join(f"{v:.3f}" for v in nis["band95"])
        mark = "  (!)" if _far(e) else ""
        rows.append([e["name"], f"{nis['mean_per_dof']:.3f}{mark}", band, told["T_s"], told["d"], e["folder"]])
    columns = ["take", "NIS per quantity", "95 % band", "T_s", "d", "written to"]
    odd = ["(!) far from 1: the noise found on the liveliest excerpts does not fit this take"] * any(map(_far, made))
    odd += [f"{e['name']}: the filter {lost}" for e in made if (lost := lost_car(e["facts"]))]
    tables = [table("estimates", columns, rows, "\n".join(odd))]
    checked = [e["check"] for e in made if e.get("check")]
    if checked:
        names = list(checked[0]["rmse"])
        errors = [
            [c["name"], *(f"{c['rmse'][n]:.2g}" for n in names), *(f"{c[k]['mean']:.2f}" for k in NEES)]
            for c in checked
        ]
        title = "RMSE against the simulation's truth (SI); NEES is 3 when the stated covariance is right"
        tables.append(table(title, ["take", *names, "NEES filter", "NEES smoother"], errors))
    return Group(*tables)


def _far(estimate: Mapping[str, Any]) -> bool:
    return not NIS_RANGE[0] < estimate["facts"]["nis"]["mean_per_dof"] < NIS_RANGE[1]


def proof(found: dict[str, Any]) -> Group:
    """A blind test: tier by tier with what was asked, and what other methods make of the same takes."""
    from bcid.report.proof_page import SAID, again, figures, not_run, said_by, shown, takes

    def plain(text: str) -> str:
        return text.replace("\N{NO-BREAK SPACE}", " ")

    columns = shown(found["tiers"])
    rows = [[t["tier"], takes(found, t["tier"]), plain(figures(t, columns, "{}!"))] for t in found["tiers"]]
    note = "; ".join(["goals in brackets; ! misses it", *(f"not run: {tier}" for tier in not_run(found))])
    tables = [table(f"{found['cases']} of {found['of']} cases", ["takes of", "n", "figures"], rows, note, ["figures"])]
    if found["wrong"]:
        wrong = [[w["case"], w["there"], w["said"]] for w in found["wrong"]]
        how = f"{again(found)} --case NAME writes one's recording"
        tables.append(table("not as it should be", ["case", "there", "said"], wrong, how, ["there", "said"]))
    if found["baselines"]:
        others = [
            [b["method"], str(b["n"]), *(plain(said_by(b, f)) for f in SAID.values())] for b in found["baselines"]
        ]
        tables.append(table("the same takes by other methods", ["method", "n", *SAID], others))
    return Group(*tables)


def real_proof(found: dict[str, Any]) -> Group:
    """What was asked of real recordings, what was answered, and whether that is right."""
    from bcid.report.proof_page import raised

    rows = [
        [
            r["tier"], Path(r["recording"]).stem[-24:], r["case"], raised(r, "{:.2f}"),
            ", ".join(f["effect"] for f in r["findings"]) or r["verdict"], "yes" if r["right"] else "NO",
        ]
        for r in found["rows"]
    ]  # fmt: skip
    told = "; ".join(
        f"{tier}: {t['right']} of {t['n']}"
        + (
            f" ({t['named']} by name, {t['first']} first, {t['alone']} alone), "
            f"{t['accepted']} of {t['names']} names accepted"
            if "named" in t
            else ""
        )
        for tier, t in found["tiers"].items()
    )
    return Group(
        table(
            "real recordings",
            ["tier", "recording", "what", "error", "answered", "right"],
            rows,
            told,
            ["what", "answered"],
        )
    )


def bench(found: Mapping[str, Any]) -> Table:
    """Hot paths beside their peers."""
    rows = [
        [
            r["path"], f"{r['ours_ms']:.3g}", r["peer"], f"{r['peer_ms']:.3g}", f"{r['ratio']:.3g} ×",
            "–" if r["goal"] is None else f"{r['goal']:g} ×{' missed' if r['missed'] else ''}",
            "–" if r["difference"] is None else f"{r['difference']:.1g}",
        ]
        for r in found["rows"]
    ]  # fmt: skip
    absent = [name for name, version in found["versions"].items() if version is None]
    caption = f"{found['machine']['processor']}, {found['machine']['cores']} cores; medians of {found['repeats']} turns"
    if absent:
        caption += f"; not installed and left out: {', '.join(absent)} (pip install -e '.[bench]')"
    columns = ["path", "ours, ms", "peer", "peer, ms", "ratio", "goal", "largest difference"]
    return table("hot paths beside their peers", columns, rows, caption)


def accuracy(found: Mapping[str, Any]) -> Group:
    """Our models beside their peers, best at the end first, a table for each data."""
    parts: list[Any] = []
    for data in dict.fromkeys(line["data"] for line in found["table"]):
        some = [line for line in found["table"] if line["data"] == data]
        horizons = [k for k, v in some[0].items() if isinstance(v, Mapping)]
        some.sort(key=lambda line: line["end"]["nmse"] or float("inf"))
        rows = [
            [line["model"], *(_with_interval(line[h]) for h in horizons),
             "–" if line["end"]["spread"] is None else f"{100 * line['end']['spread']:.0f} %"]
            for line in some
        ]  # fmt: skip
        title = f"{data}: closed loop, NMSE × 10³ (95 %), started anew every so often or never; median of the seeds"
        parts.append(table(title, ["model", *horizons, "seeds change"], rows))
    return Group(*parts, *(f"missed: {text}" for text in found["missed"]))


def _with_interval(figure: Mapping[str, Any]) -> str:
    low, high = (thousandths(v) for v in figure["ci95"] or (None, None))
    return "diverged" if figure["nmse"] is None else f"{thousandths(figure['nmse'])} ({low} – {high})"


def recovery(found: Mapping[str, Any]) -> Table:
    """How often the intervals of a simulated car's constants hold."""
    rows = [
        [r["loss"], r["symbol"], str(r["n"]),
         *(("–",) * 3 if not r["n"] else (
             f"{100 * r['covered']:.0f} %", f"{100 * r['median_error']:.2g} %", f"{r['bias_in_errors']:+.1f}"))]
        for r in found["rows"]
    ]  # fmt: skip
    title = (
        f"{found['fits']} takes of {found['seconds']:g} s, the paper's car: true constants in the stated 95 % intervals"
    )
    return table(title, ["loss", "constant", "told", "within", "median error", "bias, s.e."], rows)


def health(told: Sequence[Mapping[str, Any]]) -> str:
    """The health of recordings, a paragraph each."""
    lines = []
    for t in told:
        lines += [str(t["recording"]), f"  {t['sentence']}"]
        if not t["refused"]:
            lines.append(f"  clock offset: {_clock(t['clock'])}")
            lines += [f"  {text}" for text in t["odd"]]
    return "\n".join(lines)

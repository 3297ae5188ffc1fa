"""Results of commands as tables for people."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from bcid.cli.sink import plain_table
from bcid.documents.diagnosis import Detectable, DiagnosisDocument
from bcid.documents.health import ClockEstimate, HealthDocument
from bcid.documents.prove import ProveDocument
from bcid.documents.prove_real import RealProofDocument
from bcid.documents.report import ModelScore, ReportDocument
from bcid.documents.varied_limits import VariedLimitsDocument
from bcid.errors import printable
from bcid.estimate.consistency import TruthCheck
from bcid.estimate.saving import EstimateSummary
from bcid.report.formats import format_number, format_thousandths, format_with_error, plain_name, unit_text


def comparison_table(report: ReportDocument) -> Table:
    """Table of the compared models, lowest closed-loop NMSE first, with rollout time and number of parameters."""
    take = report.validation
    rows = [
        [
            f"{m.model} (made from this take)" if m.saw_validation else m.model, *score_cells(m),
            "–" if m.rollout_ms is None else f"{m.rollout_ms:.3g}", str(m.parameters),
        ]
        for m in report.models
    ]  # fmt: skip
    weights, machine = report.weights, report.machine
    caption = (
        f"W = diag({weights.v_x:.3g} s/m, {weights.v_y:.3g} s/m, {weights.yaw_rate:.3g} s/rad); "
        f"rollout of the whole take on {machine.processor}, {machine.cores} cores"
    )
    title = f"closed loop on {take.name} ({take.duration_s:.0f} s)"
    columns = ["model", "10³ NMSE", "95 % interval", "v_x", "v_y", "yaw rate", "rollout ms", "parameters"]
    return plain_table(title, columns, rows, caption)


def score_cells(score: ModelScore) -> list[str]:
    """A model's closed-loop errors in thousandths as cells: NMSE, its 95 % interval, that of v_x, v_y and yaw rate."""
    interval = "–" if score.nmse_ci95 is None else " – ".join(format_thousandths(v) for v in score.nmse_ci95)
    channels = (score.nmse_vx, score.nmse_vy, score.nmse_yaw_rate)
    return [format_thousandths(score.nmse), interval, *map(format_thousandths, channels)]


def diagnosis_tables(document: DiagnosisDocument) -> Group:
    """A diagnosis as text and tables: verdict, findings, prediction errors on held-out blocks, effects not excited."""
    from bcid.report.budget_words import budget_rows
    from bcid.report.drive_words import describe_start
    from bcid.report.verdict_words import short_take_sentence, verdict_sentence

    parts: list[Any] = [escape(" ".join(filter(None, [verdict_sentence(document), short_take_sentence(document)])))]
    if document.contacts:
        hits = ", ".join(f"{c.kind} at {c.begin_s:.1f} s" for c in document.contacts)
        parts.insert(0, f"excluded: {hits}")
    rows = [
        [
            plain_name(f.effect), f.equation,
            ", ".join(f"{s} = {format_with_error(v.value, v.se, v.unit)}" for s, v in f.parameters.items()),
            _format_decimals(f.probability, 2), _format_decimals(f.heldout_gain, 0), ", ".join(f.twins) or "–",
        ]
        for f in document.findings
    ]  # fmt: skip
    if rows:
        columns = ["effect", "equation", "fitted", "probability", "held-out gain (nats)", "indistinguishable from"]
        parts.append(plain_table("findings", columns, rows))
    free = [h for h in document.horizons if h.remainder_lost is not None]
    stages = {
        "before": [h.nmse_before for h in document.horizons],
        "after": [h.nmse_after for h in document.horizons],
        **({"with free functions": [h.nmse_remainder for h in document.horizons]} if free else {}),
        "noise floor": [h.nmse_floor for h in document.horizons],
    }
    judged = [
        [
            f"{h.horizon_s:g} s",
            *(format_thousandths(values[row]) for values in stages.values()),
            " – ".join(f"{v:.3g}" for v in h.ratio_ci95 or ()),
        ]
        for row, h in enumerate(document.horizons)
    ]
    title = "closed loop on held-out blocks, NMSE × 10³"
    lost = _lost_shares({h.horizon_s: h.lost for h in document.horizons})
    note = f"left out, where predictions leave the finite numbers: {lost} of the time" if lost else ""
    lost_free = _lost_shares({h.horizon_s: h.remainder_lost for h in free})
    note += f"{'; ' if note else ''}with free functions {lost_free}" if lost_free else ""
    parts.append(plain_table(title, ["horizon", *stages, "after/before (95 %)"], judged, note))
    if document.error_budget:
        budget = document.error_budget
        shares = [[row.label, row.share, row.interval, row.remark] for row in budget_rows(budget)]
        title = f"what the base model's {budget.horizon_s:g} s error is made of"
        parts.append(plain_table(title, ["part", "share", "95 % interval", ""], shares))
    if document.not_excited:
        unseen = ", ".join(
            f"{u.effect} at any size"
            if (least := u.smallest_detectable or Detectable()).value is None
            else f"{u.effect} below {format_number(least.value)} {unit_text(least.unit)}".rstrip(" –")
            for u in document.not_excited
        )
        parts.append(escape(f"could not be seen here: {unseen}"))
    if document.next_manoeuvre:
        drive = document.next_manoeuvre
        parts.append(escape(f"next: drive {drive.name} ({drive.file}): {drive.why} {describe_start(drive)}".rstrip()))
    return Group(*parts)


def _lost_shares(lost: Mapping[float, float | None]) -> str:
    """Shares of the time at which predictions are lost, by horizon (s), as text; empty where none are."""
    return ", ".join(f"{100.0 * share:.2g} % at {horizon:g} s" for horizon, share in lost.items() if share)


def _format_decimals(value: float | None, places: int) -> str:
    """A number rounded to `places` decimals, as text; a dash for None."""
    return "–" if value is None else f"{value:.{places}f}"


def recording_tables(summaries: Sequence[Mapping[str, Any]]) -> Group:
    """Tables of ingested recordings (contents of recording.json): length, rate, clock offset, and what is irregular."""
    rows = [
        [
            r["name"], r["sources"][0]["format"], f"{r['duration_s']:.1f} s", f"{r['rate_hz']:.4g} Hz",
            _clock_text(ClockEstimate(**r["clock"])),
        ]
        for r in summaries
    ]  # fmt: skip
    odd = [
        [r["name"], i["kind"], i["action"], str(i["count"]), i["where"], i["detail"]]
        for r in summaries
        for i in r["irregularities"]
    ]
    tables = [plain_table("recordings", ["take", "format", "length", "poses", "clock offset (95 %)"], rows)]
    if odd:
        tables.append(plain_table("irregularities", ["take", "what", "done", "count", "where", "detail"], odd))
    return Group(*tables)


def _clock_text(clock: ClockEstimate) -> str:
    """The command clock's offset from the pose clock (ms) with its 95 % interval as text, or why there is none."""
    if clock.offset_s is None or clock.offset_ci95 is None:
        return f"none: {clock.reason or 'not estimated'}"
    low, high = clock.offset_ci95
    return f"{1e3 * clock.offset_s:.1f} ms ({1e3 * low:.1f} … {1e3 * high:.1f})"


def _sign_text(clock: ClockEstimate) -> str:
    """What a sure offset of the command clock may mean, and what would look like it; empty where it may be zero."""
    low, high = clock.offset_ci95 or (0.0, 0.0)
    if low > 0.0:
        return ": commands are stamped early, or the car answers late (steering_delay, motor_delay)"
    return ": commands are stamped late, or poses early" if high < 0.0 else ""


class EstimatedTake(NamedTuple):
    """One estimated take: its summary, the folder of its artifact, and its check where a truth is known."""

    summary: EstimateSummary
    folder: Path
    check: TruthCheck | None

    def as_json(self) -> dict[str, Any]:
        """The take's entry in the command's JSON."""
        check = self.check and self.check.model_dump(mode="json")
        return self.summary.model_dump(mode="json") | {"folder": str(self.folder), "check": check}


def estimate_tables(takes: Sequence[EstimatedTake]) -> Group:
    """Tables of estimated takes: the filter's NIS, steering constants T_s and d, errors where true motion is known."""
    rows, notes = [], list[str]()
    for summary, folder, _ in takes:
        nis, (T_s, d, *_) = summary.filter.nis, [value for _, value in summary.tuning.describe_steering()]
        band = " … ".join(f"{v:.3f}" for v in nis.band95)
        rows.append(
            [summary.name, f"{nis.mean_per_dof:.3f}{'' if nis.plausible else '  (!)'}", band, T_s, d, str(folder)]
        )
        if lost := summary.filter.describe_restarts():
            notes.append(f"{summary.name}: the filter {lost}")
        if resampled := summary.describe_resampling():
            notes.append(f"{summary.name}: {resampled}")
    if not all(take.summary.filter.nis.plausible for take in takes):
        notes.insert(0, "(!) far from 1: the noise found on the liveliest excerpts does not fit this take")
    columns = ["take", "NIS per quantity", "95 % band", "T_s", "d", "written to"]
    tables = [plain_table("estimates", columns, rows, "\n".join(notes))]
    checks = [take.check for take in takes if take.check]
    if checks:
        errors = [
            [c.name, *(f"{rmse:.2g}" for _, rmse in c.rmse), f"{c.nees_filter.mean:.2f}", f"{c.nees_smoother.mean:.2f}"]
            for c in checks
        ]
        title = "RMSE against the simulation's truth (SI); NEES is 3 when the stated covariance is right"
        columns = ["take", *(name for name, _ in checks[0].rmse), "NEES filter", "NEES smoother"]
        tables.append(plain_table(title, columns, errors))
    return Group(*tables)


def proof_tables(outcome: ProveDocument) -> Group:
    """Tables of a blind test: scores by tier (kind of simulated take), wrong answers, and other methods' scores."""
    from bcid.report import proof_page

    def plain(text: str) -> str:
        return text.replace("\N{NO-BREAK SPACE}", " ")

    columns = proof_page.filled_columns(outcome.tiers)
    rows = [
        [t.tier, proof_page.count_takes(outcome, t.tier), plain(proof_page.tier_figures(t, columns, "{}!"))]
        for t in outcome.tiers
    ]
    not_run = (f"not run: {tier}" for tier in proof_page.tiers_not_run(outcome))
    note = "; ".join(["goals in brackets; ! misses it", *not_run])
    title = f"{outcome.cases} of {outcome.of} cases"
    tables = [plain_table(title, ["takes of", "n", "figures"], rows, note)]
    if outcome.wrong:
        wrong = [[w.case, w.there, w.said] for w in outcome.wrong]
        how = f"{proof_page.suite_options(outcome)} --case NAME writes one's recording"
        tables.append(plain_table("wrong answers", ["case", "there", "said"], wrong, how))
    if outcome.baselines:
        figures = proof_page.METHOD_FIGURES
        others = [
            [b.method, str(b.n), *(plain(proof_page.method_figure(b, f)) for f in figures.values())]
            for b in outcome.baselines
        ]
        tables.append(plain_table("the same takes by other methods", ["method", "n", *figures], others))
    return Group(*tables)


def varied_limits_tables(outcome: VariedLimitsDocument) -> Group:
    """Tables of limits.json: verdicts that change with half and twice of each limit; which; takes without a verdict."""
    rows = [
        [
            v.limit, f"{v.value:g}", str(v.takes), *(f"{n} ({value:g})" for n, value in (
                (v.changed_halved, v.halved), (v.changed_doubled, v.doubled))),
            "–" if v.changed_share is None else f"{100.0 * v.changed_share:.2g} %"
            + " missed" * (v.changed_share > outcome.goal),
        ]
        for v in outcome.limits
    ]  # fmt: skip
    title = f"verdicts that change, {outcome.diagnosed} of {outcome.takes} takes with all values"
    columns = ["limit", "value", "takes", "halved", "doubled", "of all"]
    tables = [plain_table(title, columns, rows, f"goal: ≤ {100.0 * outcome.goal:g} % with each limit")]
    if outcome.changes:
        changed = [[f"{c.limit} = {c.value:g}", c.case, c.there or "–", c.before, c.after] for c in outcome.changes]
        columns = ["limit", "case", "there", "before", "after"]
        tables.append(plain_table("changed verdicts", columns, changed, ""))
    if outcome.failed:
        failed = [[f.case, f"{f.limit} = {f.value:g}" if f.limit else "as they are", f.error] for f in outcome.failed]
        tables.append(plain_table("without a verdict", ["case", "limits", "error"], failed, ""))
    return Group(*tables)


def real_proof_tables(document: RealProofDocument) -> Group:
    """Tables of real.json: figures of the answers about real recordings beside their goals, and every answer."""
    from bcid.proof.real.figures import describe_figure
    from bcid.report.real_answers import answer_text, question_text, worth_text

    figures = [[f.figure, describe_figure(f), "missed" if f.missed else ""] for f in document.figures]
    rows = [
        [r["tier"], Path(r["recording"]).stem[-24:], question_text(r), worth_text(r), answer_text(r, ""),
         "yes" if r["right"] else "NO"]
        for r in document.rows
    ]  # fmt: skip
    columns = ["tier", "recording", "what", "worth", "answered", "right"]
    return Group(
        plain_table("real recordings", ["figure", "value", ""], figures, ""),
        plain_table("answers", columns, rows, ""),
    )


def goal_of_timing(row: Mapping[str, Any]) -> str:
    """What is wanted of a row of the speed benchmark, in print: a ratio, a longest time, and whether it is missed."""
    wanted = [f"{row['goal']:g} ×"] if row["goal"] is not None else []
    wanted += [f"≤ {row['longest_ms']:.3g} ms"] if row["longest_ms"] is not None else []
    return (", ".join(wanted) or "–") + (" missed" if row["missed"] else "")


def speed_table(outcome: Mapping[str, Any]) -> Table:
    """Table of `bcid bench speed`: each hot path's time beside that of other libraries, ratio, goal and difference."""
    rows = [
        [
            r["path"], f"{r['ours_ms']:.3g}", r["peer"], f"{r['peer_ms']:.3g}", f"{r['ratio']:.3g} ×",
            goal_of_timing(r),
            "–" if r["difference"] is None else f"{r['difference']:.1g}",
        ]
        for r in outcome["rows"]
    ]  # fmt: skip
    skipped = [f"{s['peer']} ({s['path']}): {s['reason']}" for s in outcome["skipped"]]
    caption = (
        f"{outcome['machine']['processor']}, {outcome['machine']['cores']} cores; medians of {outcome['repeats']} turns"
        " of CPU time"
    )
    if skipped:
        caption += f"; left out: {'; '.join(skipped)}"
    columns = ["path", "ours, ms", "peer", "peer, ms", "ratio", "goal", "largest difference"]
    return plain_table("hot paths beside their peers", columns, rows, caption)


def accuracy_tables(outcome: Mapping[str, Any]) -> Group:
    """Tables of `bcid bench accuracy`: closed-loop NMSE of our models and other libraries', one table a data set.

    Rows are sorted by the NMSE over a whole take; goals that are missed follow as text.
    """
    parts: list[Any] = []
    for data in dict.fromkeys(line["data"] for line in outcome["table"]):
        lines = [line for line in outcome["table"] if line["data"] == data]
        horizons = [k for k, v in lines[0].items() if isinstance(v, Mapping)]
        lines.sort(key=lambda line: line["end"]["nmse"] or float("inf"))
        rows = [
            [line["model"], *(_nmse_with_interval(line[h]) for h in horizons),
             "–" if line["end"]["spread"] is None else f"{100 * line['end']['spread']:.0f} %"]
            for line in lines
        ]  # fmt: skip
        title = f"{data}: closed loop, NMSE × 10³ (95 %), started anew every so often or never; median of the seeds"
        parts.append(plain_table(title, ["model", *horizons, "seeds change"], rows))
    return Group(*parts, *(f"missed: {text}" for text in outcome["missed"]))


def _nmse_with_interval(figure: Mapping[str, Any]) -> str:
    """The NMSE of a figure {"nmse", "ci95"} in thousandths with its 95 % interval as text, or "diverged"."""
    low, high = (format_thousandths(v) for v in figure["ci95"] or (None, None))
    return "diverged" if figure["nmse"] is None else f"{format_thousandths(figure['nmse'])} ({low} – {high})"


def coverage_table(outcome: Mapping[str, Any]) -> Table:
    """Table of `bcid bench parameters`: how often 95 % intervals hold a simulated car's constants; errors and bias."""
    rows = [
        [r["loss"], r["symbol"], str(r["n"]),
         *(("–",) * 3 if not r["n"] else (
             f"{100 * r['covered']:.0f} %", f"{100 * r['median_error']:.2g} %", f"{r['bias_in_errors']:+.1f}"))]
        for r in outcome["rows"]
    ]  # fmt: skip
    takes = f"{outcome['fits']} takes of {outcome['seconds']:g} s, the paper's car"
    title = f"{takes}: true constants in the stated 95 % intervals"
    return plain_table(title, ["loss", "constant", "stated", "within", "median error", "bias, s.e."], rows)


def fleet_cost_table(outcome: Mapping[str, Any]) -> Table:
    """Table of `bcid bench fleet`: time, memory and disk of each fleet, and what an archive would cost."""
    rows = [
        [str(r["logs"]), str(r["workers"]), f"{r['cpu_s_per_log']:.1f} s", f"{r['wall_s']:.0f} s",
         f"{r['peak_mib']:.0f} MiB", f"{r['disk_mib'] / r['logs']:.1f} MiB", str(r["failed"])]
        for r in outcome["rows"]
    ]  # fmt: skip
    archive, faster = outcome["archive"], outcome["speed_up"]
    said = f"{outcome['workers']} workers are {faster:.2f} times as fast as one; " if faster else ""
    caption = (
        f"{said}not measured but reckoned, for {archive['hours']:,.0f} hours of logs: "
        f"{archive['cpu_hours']:,.0f} CPU hours, {archive['disk_gib']:,.0f} GiB"
    )
    columns = ["logs", "workers", "CPU a log", "time", "memory of a process", "disk a log", "failed"]
    return plain_table(f"fleets of logs of {outcome['seconds']:g} s", columns, rows, caption)


def health_text(health: HealthDocument) -> str:
    """Whether each recording is worth fitting and why, its clock offset and its findings, as text: a paragraph each."""
    lines = []
    for take in health.recordings:
        lines += [printable(take.recording, ""), f"  {take.sentence}"]
        if take.clock:
            lines.append(f"  clock offset: {_clock_text(take.clock)}{_sign_text(take.clock)}")
            lines += [f"  {text}" for text in take.findings]
    return "\n".join(lines)
